"""The site, `python -m sphinx -W -b html docs OUT`: what Sphinx is told, pages brought from other folders,
docstrings as reStructuredText, and what the presets say of themselves."""

import ast
import inspect
import re
import shutil
import sys
import textwrap
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path.insert(0, str(ROOT))  # the package beside these pages, installed or not

from sysid import __version__  # noqa: E402
from sysid.columns.preset import PREFIX, Preset, presets  # noqa: E402

project, release, html_title = "sysid", __version__, f"sysid {__version__}"
extensions = ["myst_nb", "sphinx.ext.autodoc"]
html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = html_show_copyright = html_show_sphinx = False
nb_execution_mode = "off"  # notebooks are shown as they were run
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"  # of the browser, so that pages ask for nothing
smartquotes = False  # quotes are part of what is typed
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"

ELSEWHERE = ("notebooks", "benchmarks", "data")  # folders of the repository whose pages the site shows too
SHOWN = ("*.ipynb", "*.md", "*.png", "*.toml")
FACTS = {
    "quantity": "what the signal shows",
    "kind": "that the rows are raw samples",
    "columns": "which channel is the drive",
}


def bring(_app: Sphinx, _config: object) -> None:
    """Copy the pages of other folders beside these, where Sphinx looks for them; git ignores the copies."""
    for folder in ELSEWHERE:
        shutil.rmtree(HERE / folder, ignore_errors=True)
        for found in (path for form in SHOWN for path in sorted((ROOT / folder).rglob(form))):
            copy = HERE / found.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(found, copy)  # with its date: what has not changed is not read again


def beside(_app: Sphinx, page: str, source: list[str]) -> None:
    """Links as they are for the copies: what lies beside `docs` lies in it."""
    source[0] = source[0].replace(*("](../docs/", "](../") if "/" in page else ("](../", "]("))


def anchored(_app: Sphinx, page: nodes.document) -> None:
    """Headings by the names that links from a repository's page give them as well, `#second_mode`."""
    for section in page.findall(nodes.section):
        slug = section.get("slug")
        if slug and slug not in page.ids:
            section["ids"].append(slug)


def formula(writer: object, node: nodes.Element) -> None:
    """TeX as MathML, whose maker takes a degree for text alone."""
    tex = node.astext().replace("°", r"\text{°}")
    writer.body.append(tex2mathml(tex, as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def marked(text: str) -> str:
    """A paragraph of a docstring: `x` is code, and nothing else is markup."""
    parts = re.split(r"`+([^`]+)`+", text)
    plain = [re.sub(r"([\\*_|])", r"\\\1", part) for part in parts[::2]]
    code = [f"``{' '.join(part.split())}``" for part in parts[1::2]] + [""]
    return "".join(a + b for a, b in zip(plain, code, strict=True))


def restructured(
    _app: Sphinx, what: str, _name: str, obj: object, _options: object, lines: list[str]
) -> None:
    """Docstrings as reStructuredText: indented paragraphs, as equations are, stand as they were written."""
    paragraphs = re.split(r"\n\s*\n", "\n".join(lines).strip("\n"))
    told = []
    for paragraph in paragraphs:
        if paragraph.startswith(">>>"):
            told.append(paragraph)
        elif paragraph.startswith(" "):
            told.append("::\n\n" + textwrap.indent(textwrap.dedent(paragraph), "    "))
        else:
            told.append(marked(paragraph))
    if what == "class":
        told.append("\n".join(f"- ``{name}``: {marked(said)}" for name, said in fields(obj)))
    lines[:] = "\n\n".join(told).splitlines()


def fields(of: type) -> list[tuple[str, str]]:
    """What comments behind or above the fields of a class say of them."""
    try:
        source = textwrap.dedent(inspect.getsource(of))
    except (OSError, TypeError):
        return []
    lines, body = source.splitlines(), ast.parse(source).body[0].body
    found = []
    for node in (node for node in body if isinstance(node, ast.AnnAssign)):
        above = lines[node.lineno - 2].strip()
        behind = lines[node.end_lineno - 1][node.end_col_offset :].partition("#")[2].strip()
        said = behind or (above.removeprefix("# ") if above.startswith("# ") else "")
        if said:
            found.append((node.target.id, said))
    return found


def skipped(_app: Sphinx, _what: str, _name: str, obj: object, _skip: bool, _options: object) -> bool | None:
    """Fields of named tuples, of which Python itself says only their number."""
    return True if str(getattr(obj, "__doc__", "")).startswith("Alias for field number") else None


class Presets(SphinxDirective):
    """`{presets}`: a section for each mapping file that ships, from what it says itself."""

    def run(self) -> list[nodes.Node]:
        """Nodes of all sections."""
        text = "\n\n".join(map(_told, presets().values()))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def _told(preset: Preset) -> str:
    asked = f"    identify --columns {PREFIX}{preset.name} LOGS"
    if preset.recognised and not preset.assumed:
        how = f"Read as they are, `identify LOGS`; or\n\n{asked}"
    elif preset.recognised:
        how = f"{asked}\n\nFiles are recognised: without it, the message names it."
    else:
        how = asked
    said = [f"## {preset.name}", f"{preset.title}.", how]
    if preset.assumed:
        assumed = ", ".join(FACTS[key] for key in preset.assumed)
        said.append(f"Assumed, because no file tells: {assumed}. A line of a mapping file says otherwise.")
    if preset.also:
        said.append(f"Also by the names {', '.join(f'`{name}`' for name in preset.also)}.")
    return "\n\n".join([*said, f"```toml\n{preset.text.rstrip()}\n```"])


def setup(app: Sphinx) -> None:
    """Tell Sphinx of all this."""
    app.add_directive("presets", Presets)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("config-inited", bring)
    app.connect("source-read", beside)
    app.connect("doctree-read", anchored)
    app.connect("autodoc-process-docstring", restructured)
    app.connect("autodoc-skip-member", skipped)
