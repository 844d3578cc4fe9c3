"""Models beside their compressed twins: see README.md in this folder."""
