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
html_theme = "furo"
html_title = "lidaremu"
ACCENT = {"light": "#00796b", "dark": "#4db6ac"}
html_theme_options = {
    f"{mode}_css_variables": {
        "color-brand-primary": colour,
        "color-brand-content": colour,
        "font-stack": "system-ui, sans-serif",
        "font-stack--monospace": "ui-monospace, 'Cascadia Code', 'DejaVu Sans Mono', monospace",
    }
    for mode, colour in ACCENT.items()
}
html_css_files = ["custom.css"]
html_static_path = ["static"]
html_copy_source = False
html_show_sphinx = False
suppress_warnings = ["misc.highlighting_failure"]

LINK = re.compile(r"\]\(([\w./-]+\.md)\)")
NAMES = {"../README.md": "Overview <{}>"}
"Pages whose own title says little in the sidebar."


def with_contents(app, docname, source):
    """The pages that a chapter of the index links are its contents, in that order; the chapters head the sidebar."""
    if docname != root_doc:
        return
    known = set()
    for part in source[0].split("\n## "):
        title, _, text = part.partition("\n")
        pages = [page for page in dict.fromkeys(LINK.findall(text)) if page not in known]
        known.update(pages)
        caption = "" if title.startswith("# ") else f":caption: {title}\n"
        entries = "\n".join(NAMES.get(page, "{}").format(page.removesuffix(".md")) for page in pages)
        source[0] += f"\n\n```{{toctree}}\n:hidden:\n{caption}\n{entries}\n```\n" if pages else ""


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
