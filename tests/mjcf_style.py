"""The one way to write an MJCF file, as collections of MuJoCo models ask for it.

Two spaces a level, double quotes, one space between attributes, `/>` without a space before it, a
comment on lines of its own, at most one blank line, and lines of at most 120 columns: attributes
that do not fit go on, one level deeper.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from xml.sax.saxutils import escape

WIDTH = 120


def canonical(text: str) -> str:
    """The same document, written in the one way."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    return "\n".join(_lines(ElementTree.fromstring(text, parser), "")) + "\n"


def _lines(node: ElementTree.Element, indent: str) -> Iterator[str]:
    if node.tag is ElementTree.Comment:
        yield f"{indent}<!--{node.text}-->"
        return
    values = {k: escape(" ".join(v.split()), {'"': "&quot;"}) for k, v in node.items()}
    words = [f"{indent}<{node.tag}", *(f'{key}="{value}"' for key, value in values.items())]
    words[-1] += ">" if len(node) else "/>"
    line = words[0]
    for word in words[1:]:
        if len(line) + 1 + len(word) > WIDTH:
            yield line
            line = f"{indent}  {word}"
        else:
            line += f" {word}"
    yield line
    before = node.text or ""
    for child in node:
        if before.count("\n") > 1:
            yield ""
        yield from _lines(child, indent + "  ")
        before = child.tail or ""
    if len(node):
        yield f"{indent}</{node.tag}>"
