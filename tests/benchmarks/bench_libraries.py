"""What libraries would do instead of our own parts: the figures behind "Libraries tried" in docs/architecture.md.

    python -m tests.benchmarks.bench_libraries [JOB...] [--tests]

Jobs: expressions, captures, plots, terminal, metrics, rpc; all when none is named. `--tests` also runs our own tests
with each library in the place of ours (minutes). A library that is not there is told as `not installed`:

    python -m pip install simpleeval asteval numexpr RestrictedPython cel-python common-expression-language \\
        python-pcapng dpkt scapy plotext uniplot asciichartpy blessed prompt_toolkit textual \\
        prometheus_client jsonrpcserver json-rpc python-lsp-jsonrpc pygls

into an environment of its own. Times are processor time.
"""

from __future__ import annotations

import argparse
import importlib
import platform

JOBS = ("expressions", "captures", "plots", "terminal", "metrics", "rpc")


def main() -> None:
    """Print every job's rows."""
    parser = argparse.ArgumentParser(description="What libraries would do instead of our own parts.")
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=f"of {', '.join(JOBS)}")
    parser.add_argument("--tests", action="store_true", help="run our tests with each library, too")
    chosen = parser.parse_args()
    if unknown := set(chosen.jobs) - set(JOBS):
        parser.error(f"{', '.join(sorted(unknown))}; want {', '.join(JOBS)}")
    print(f"Python {platform.python_version()}, {platform.machine()}")
    for job in chosen.jobs or JOBS:
        trial = importlib.import_module(f"tests.benchmarks.libraries.{job}")
        print(f"\n{job}: {trial.__doc__.splitlines()[0]}")
        for row in trial.rows(*([True] if chosen.tests and job in ("captures", "plots", "metrics", "rpc") else [])):
            print(f"  {row.name}" + ("" if row.found else ": not installed"))
            for what, value in row.found.items():
                print(f"    {what:30} {value}")


if __name__ == "__main__":
    main()
