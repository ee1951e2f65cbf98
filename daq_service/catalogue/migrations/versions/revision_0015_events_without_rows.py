"""Events that report a row of a set have no payload; those of earlier versions keep theirs.

No column changes: the number keeps earlier versions from a catalogue whose events they cannot read.
"""

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Change nothing."""
