"""The commands as a whole: their list, their help, and what asking for help imports."""

import subprocess
import sys

import pytest

from map_racing.cli import COMMANDS, main

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


@pytest.mark.once
def test_help_imports_no_heavy_library():
    code = (
        "import sys\nfrom map_racing.cli import main\n"
        "try: main(sys.argv[1:])\nexcept SystemExit: pass\n"
        f"print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    calls = [[command] for command in COMMANDS]
    calls += [[command, action] for command, actions in ACTIONS.items() for action in actions]
    for call in [[], *calls]:
        done = subprocess.run(
            [sys.executable, "-c", code, *call, "--help"], capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "[]\n"), call


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
