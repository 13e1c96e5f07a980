"""How the pages are built: `bash .ci/docs`. Sphinx with MyST over the whole project, so that links to code are checked.

Belongs here: options of the builder. Not: text. Pages are plain Markdown and read the same on a code server.
"""

import re

from docutils import nodes
from latex2mathml.converter import convert

project = "lidaremu"
author = "the lidaremu authors"
extensions = ["myst_parser"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath"]
myst_dmath_double_inline = True
myst_heading_anchors = 4
source_suffix = {".md": "markdown"}
root_doc = "docs/index"
include_patterns = ["docs/*.md", "README.md", "SECURITY.md", "CHANGELOG.md", "protocols/COVERAGE.md"]
exclude_patterns = [".*", "reports", "build", "tests", "emulator", "scenarios", "mutants"]
highlight_language = "none"
nitpicky = True
html_theme = "alabaster"
html_theme_options = {"description": "A lidar in software", "page_width": "1160px"}
html_static_path = ["static"]
html_copy_source = False
html_show_sphinx = False
suppress_warnings = ["misc.highlighting_failure"]

LINK = re.compile(r"\]\(([\w./-]+\.md)\)")


def with_contents(app, docname, source):
    """The pages that the index links are its contents, in that order."""
    if docname != root_doc:
        return
    found = dict.fromkeys(LINK.findall(source[0]))
    entries = "\n".join(page.removesuffix(".md") for page in found)
    source[0] += f"\n\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n"


def formula(self, node):
    """Formulas as MathML, which browsers draw themselves: no script, nothing from the network."""
    block = isinstance(node, nodes.math_block)
    made = convert(node.astext(), display="block" if block else "inline")
    self.body.append(f'<div class="math">{made}</div>' if block else made)
    raise nodes.SkipNode


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("source-read", with_contents)
