"""Metadata of the package: README whose relative links also work on a package page."""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_RELATIVE = re.compile(r"(?<=\]\()(?!\w+:|#)(?=[^)]+\))")


class ReadmeHook(MetadataHookInterface):
    """Puts the address in CMF_MJ_PAGES before README's relative links and pictures."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the long description."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        pages = os.environ.get("CMF_MJ_PAGES", "")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": _RELATIVE.sub(pages, text),
        }
