#!/usr/bin/env python3
"""Copies the facts of newer MAVLink definitions to definitions/, and keeps our own descriptions.

    refresh.py UPSTREAM_DIRECTORY [TARGET_DIRECTORY [NAME...]]

Names, ids, types, order, units, values, ranges and lifecycle elements come from upstream. Upstream's descriptions and comments
are not copied. Our `<description>` of an element is kept with the element of the same name. By default, minimal, standard and
common are written to definitions/. The test fixtures use other names and another target. Requires only Python 3.9.
"""

import os
import sys
import xml.etree.ElementTree as ET

HERE = os.path.dirname(os.path.abspath(__file__))
NAMED = ("enum", "entry", "message", "field")
# Elements whose text is a fact.
TEXT = ("include", "version", "dialect")
LIFECYCLE = ("wip", "deprecated", "superseded")


def named(node, key=()):
    """Yields all named elements, with their paths of names."""
    for child in node:
        if child.tag in NAMED:
            path = (*key, child.tag, child.get("name"))
            yield path, child
            yield from named(child, path)
        else:
            yield from named(child, key)


def descriptions(path):
    """Returns the descriptions in a file, by element."""
    if not os.path.exists(path):
        return {}
    found = ((key, node.findtext("description")) for key, node in named(ET.parse(path).getroot()))
    return {key: text for key, text in found if text}


def strip(node):
    """Removes everything but facts."""
    for child in list(node):
        if child.tag == "description":
            node.remove(child)
        else:
            strip(child)
    node.text = node.text.strip() if node.tag in TEXT and node.text else None
    node.tail = None


def describe(root, texts):
    for key, node in named(root):
        if key in texts or node.tag == "message":
            description = ET.Element("description")
            description.text = texts.pop(key, None)
            # In the schema it follows the lifecycle element and precedes all others.
            node.insert(1 if len(node) and node[0].tag in LIFECYCLE else 0, description)
    for key in texts:
        print("no longer in upstream:", " ".join(key), file=sys.stderr)


def refresh(source, target, texts):
    root = ET.parse(source).getroot()
    strip(root)
    describe(root, texts)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode").replace(" />", "/>")
    with open(target, "w", encoding="utf-8") as file:
        file.write(f"<?xml version='1.0' encoding='UTF-8'?>\n{text}\n")


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    upstream = sys.argv[1]
    directory = sys.argv[2] if len(sys.argv) > 2 else os.path.join(HERE, "definitions")
    for name in sys.argv[3:] or ["minimal", "standard", "common"]:
        target = os.path.join(directory, f"{name}.xml")
        refresh(os.path.join(upstream, f"{name}.xml"), target, descriptions(target))


if __name__ == "__main__":
    main()
