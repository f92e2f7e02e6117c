"""``python -m map_racing`` is the command line."""

from .start import command_line

if __name__ == "__main__":
    command_line()
