"""Options of each command, apart from its work: ``--help`` need not import what the work needs."""
