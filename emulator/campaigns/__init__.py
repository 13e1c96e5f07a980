"""Campaigns: many runs of one scenario by a design, resumed, on one machine or several, and what they show.

Belongs here: factors, designs, names of cases, the directory of cases, engines, results and their page. Not: how one
scenario is run and judged (judging), the words of the command (commands).

May import: `run_report` and below.
"""
