"""Options of each command, separate from its work, so that ``--help`` imports little."""
