"""Interactive hosts: `look`, `demo`, and what they draw on a terminal.

Belongs here: pictures made of characters. Not: decoding (hosts), the page in a browser (view).

May import: `runtime`, `studies` (drawing), `hosts`, `scenario` and below.
"""
