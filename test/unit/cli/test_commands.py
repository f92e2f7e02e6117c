"""All commands: their list, their help, and what --help imports."""

import subprocess
import sys
from importlib import import_module

import pytest

from map_racing.cli import COMMANDS, build_parser, main
from map_racing.cli.options.shared import GRIDS
from map_racing.experiments.conditions import load_conditions
from map_racing.experiments.robustness import load_robustness
from map_racing.resources import list_config

ACTIONS = {
    "lookup": ("generate", "check"),
    "raceline": ("check", "convert", "optimize"),
    "experiment": ("velocity-scaling", "tire-models"),
}
HEAVY = ("scipy", "pandas", "matplotlib", "rosbags", "tqdm")


def printed_help(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--help"])
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_help_lists_every_command_with_what_it_does(capsys):
    text = " ".join(printed_help(capsys).split())
    for command, what in COMMANDS.items():
        assert f"{command} {what}" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_shows_its_arguments(capsys, command):
    text = printed_help(capsys, command)
    assert f"usage: map-racing {command}" in text
    for action in ACTIONS.get(command, ()):
        assert action in text
        own = printed_help(capsys, command, action)
        assert f"usage: map-racing {command} {action}" in own and "--" in own


def parsers(parser):
    """A parser and the parsers of its commands and actions, with their options."""
    if getattr(parser, "command", None):
        import_module(f"map_racing.cli.options.{parser.command}").add_options(parser)
    yield parser
    for action in parser._subparsers._group_actions if parser._subparsers else ():
        for inner in action.choices.values():
            yield from parsers(inner)


def test_what_an_option_takes_has_one_name_in_all_commands():
    found = {}
    for parser in parsers(build_parser()):
        for option in parser._actions:
            if option.option_strings and option.nargs != 0:
                name = option.option_strings[-1]
                assert option.help and (option.metavar or option.choices), name
                found.setdefault(name, set()).add(option.metavar)
    alike = "--vehicle --plant --controller --track --seed --seeds --speed-scale --raceline --jobs"
    for name in (*alike.split(), "--pose-topic", "--plots", "--channels"):
        assert len(found[name]) == 1, (name, found[name])


def test_shipped_files_that_help_names_are_of_that_kind():
    for name in list_config("experiments"):
        (load_robustness if name in GRIDS else load_conditions)(name)


@pytest.mark.once
def test_help_imports_no_heavy_library():
    calls = [[], *([command] for command in COMMANDS)]
    calls += [[command, action] for command, actions in ACTIONS.items() for action in actions]
    # Each in a fork of a process that has imported nothing else.
    code = (
        "import os, sys\nfrom map_racing.cli import main\n"
        f"for call in {calls}:\n"
        "    if os.fork():\n        assert os.wait()[1] == 0, call\n        continue\n"
        "    try: main([*call, '--help'])\n    except SystemExit: pass\n"
        f"    print(call, [name for name in {HEAVY} if name in sys.modules], file=sys.stderr)\n"
        "    break\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "".join(f"{call} []\n" for call in calls))


@pytest.mark.parametrize(
    "arguments, said",
    [
        ([], "the following arguments are required: COMMAND"),
        (["rice"], "invalid choice: 'rice'"),
        (["race"], "map-racing race: error: the following arguments are required: --output"),
        (["race", "--output", "a.bag", "--lapps", "3"], "unrecognized arguments: --lapps 3"),
        (["race", "--output", "a.bag", "--laps", "x"], "argument --laps: invalid int value: 'x'"),
        (
            ["evaluate", "a.bag", "--raceline", "a.csv", "--raceline=b.csv"],
            "argument --raceline: expected once, got it again",
        ),
        (
            ["raceline", "optimize", "a.yaml", "--start", "1,2", "--start", "3", "4"],
            "argument --start: expected once, got it again",
        ),
        (["evaluate"], "map-racing evaluate: error: the following arguments are required"),
        (["lookup"], "map-racing lookup: error: the following arguments are required: ACTION"),
    ],
)
def test_usage_errors(capsys, arguments, said):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
