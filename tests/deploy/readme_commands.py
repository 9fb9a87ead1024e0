"""The commands of deploy/README.md: the first shell block of a section, as it is written there."""

import re

from commands import ROOT

README = ROOT / "deploy" / "README.md"


def block(section):
    """The first shell block below a heading of the second level."""
    [text] = re.findall(
        rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", README.read_text(), re.M | re.S
    )
    return re.search(r"^```sh\n(.*?)^```$", text, re.M | re.S)[1]
