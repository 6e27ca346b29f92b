"""A hook of mkdocs: formulas become MathML, which browsers draw without scripts or network.

`$...$` within a paragraph and `$$...$$` on separate lines, outside code; links from `docs/`
to files of the project that are no pages become plain names.
"""

import re

from latex2mathml.converter import convert

CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^\$\$\n(.*?)\n\$\$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"\$([^$]+?)\$")
UPWARDS = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+)[^)]+\)")


def on_page_markdown(markdown, page, **_):
    """Formulas and links of one page; code stays as it is."""
    depth = page.file.src_uri.count("/")
    inside = UPWARDS.sub(lambda m: m[1] if m[2].count("../") > depth else m[0], markdown)
    parts = CODE.split(inside)
    for k in range(0, len(parts), 2):
        block = BLOCK.sub(
            lambda m: f'<div class="formula">{convert(m[1], display="block")}</div>', parts[k]
        )
        # In a span: at the beginning of a line Markdown would take `<math>` for a block.
        parts[k] = INLINE.sub(lambda m: f"<span>{convert(m[1])}</span>", block)
    return "".join(parts)
