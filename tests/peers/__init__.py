"""Times whit against other renderers on the same scenes: see README.md beside this file."""
