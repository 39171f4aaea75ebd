"""Links of the pages into the repository, as the site has them.

A module of the packages leads to its highlighted source, any other file is a download, and a
folder, which a site cannot show, stays text.
"""

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

PACKAGES = ("src", "envs")


class SourceLinks(SphinxPostTransform):
    """Turn downloads of the packages' modules into links to ``_modules/``."""

    default_priority = 5
    formats = ("html",)

    def run(self, **kwargs: Any) -> None:
        """Replace them, and links to folders, in the page at hand."""
        for xref in list(self.document.findall(addnodes.pending_xref)):
            if xref.get("reftype") == "myst" and xref.get("refdomain") is None:
                _, absolute = self.env.relfn2path(xref["reftarget"], self.env.docname)
                if Path(absolute).is_dir():
                    xref.replace_self(xref.children)
        shown = getattr(self.env, "_viewcode_modules", {})
        for node in list(self.document.findall(addnodes.download_reference)):
            _, absolute = self.env.relfn2path(node["reftarget"], self.env.docname)
            module = module_of(Path(absolute), Path(self.env.srcdir))
            if module and shown.get(module):
                uri = self.app.builder.get_relative_uri(
                    self.env.docname, "_modules/" + module.replace(".", "/")
                )
                link = nodes.reference("", "", internal=True, refuri=uri)
                link += node.children
                node.replace_self(link)


def module_of(path: Path, root: Path) -> str | None:
    """The importable name of a module of the packages; None for any other file."""
    for folder in PACKAGES:
        if path.suffix == ".py" and path.is_relative_to(root / folder):
            return ".".join(path.relative_to(root / folder).with_suffix("").parts)
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Join the build."""
    app.add_post_transform(SourceLinks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
