"""What libraries do of our own parts' jobs, a module a job. Each answers `rows()`, and prints nothing.

Belongs here: adapters and trials. Not: what is measured alike for all jobs (measure), printing (bench_libraries).
"""
