"""The command line as its users meet it: exit codes, one line per error, files."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from map_racing.bags.reader import read_recording
from map_racing.cli import main
from map_racing.cli.evaluate import run_names
from map_racing.resources import find_config
from map_racing.vehicle.lookup import load_table, published_grid


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Bags of two short races, by name of the controller."""
    folder = tmp_path_factory.mktemp("races")
    paths = {}
    for controller in ("map", "pure_pursuit"):
        paths[controller] = folder / f"{controller}_0.7.bag"
        arguments = ["--laps", "2", "--speed-scale", "0.7", "--output", str(paths[controller])]
        assert main(["race", "--controller", controller, *arguments]) == 0
    return paths


def refused(capsys, *arguments):
    """Run a command that must fail; its one line on stderr."""
    assert main([str(argument) for argument in arguments]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("map-racing: ")
    return lines[0]


# -- race ----------------------------------------------------------------------------------------


def test_race_says_how_it_ended(tmp_path, capsys):
    assert main(["race", "--laps", "1", "--output", str(tmp_path / "a.bag")]) == 0
    assert "completed after 1 timed laps" in capsys.readouterr().out


def test_a_crash_is_recorded_as_far_as_it_went(tmp_path, capsys):
    path = tmp_path / "a.bag"
    arguments = ["--controller", "pure_pursuit_paper", "--speed-scale", "0.9"]
    assert main(["race", *arguments, "--output", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "crashed after 0 timed laps" in printed and "of the raceline" in printed
    assert main(["evaluate", str(path)]) == 0
    assert "N.C." in capsys.readouterr().out


def test_same_seed_same_bag(tmp_path):
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        output = str(tmp_path / f"{name}.bag")
        assert main(["race", "--laps", "1", "--seed", seed, "--output", output]) == 0
    a, b, c = (read_recording(tmp_path / f"{name}.bag") for name in "abc")
    assert np.array_equal(a.x, b.x) and not np.array_equal(a.x[:50], c.x[:50])


def test_race_with_a_table_and_sectors(tmp_path, capsys):
    table, sectors = tmp_path / "t.csv", tmp_path / "s.yaml"
    assert main(["lookup", "generate", "--vehicle", "nuc4", "--output", str(table)]) == 0
    sectors.write_text(
        "global_limit: 1.0\nn_sectors: 1\nSector0: {start: 0, end: 365, scaling: 0.5}\n"
    )
    output = ["--laps", "1", "--output", str(tmp_path / "a.bag")]
    extra = ["--lookup-table", str(table), "--speed-sectors", str(sectors)]
    assert main(["race", "--speed-scale", "1", *extra, *output]) == 0
    assert main(["evaluate", str(tmp_path / "a.bag"), "--json", str(tmp_path / "a.json")]) == 0
    (run,) = json.loads((tmp_path / "a.json").read_text())["runs"]
    assert run["summary"]["max_speed_mps"] == pytest.approx(0.5 * 8.5, abs=0.35)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--track", "nowhere"], "nowhere: .*reference"),
        (["--vehicle", "nowhere"], "nowhere: .*nuc4"),
        (["--controller", "nowhere"], "nowhere: .*pure_pursuit"),
        (["--plant", "nowhere"], "nowhere: "),
        (["--laps", "0"], "--laps must be 1 to 1000"),
        (["--speed-scale", "-1"], "speed_scale"),
        (["--speed-scale", "nan"], "speed_scale"),
        (["--lookup-table", "nowhere.csv"], "nowhere.csv"),
        (["--speed-sectors", "nowhere.yaml"], "nowhere.yaml"),
        (["--controller", "pure_pursuit", "--lookup-table", "t.csv"], "no lookup table"),
        (["--track", ""], "'': expected the name of a file"),
    ],
)
def test_race_refuses(tmp_path, capsys, arguments, said):
    line = refused(capsys, "race", *arguments, "--output", tmp_path / "a.bag")
    assert re.search(said, line), line
    assert list(tmp_path.iterdir()) == []


def test_race_refuses_a_track_in_millimeters(tmp_path, capsys):
    angle = np.arange(100) * 2.0 * np.pi / 100
    path = tmp_path / "mm.csv"
    rows = zip((5000.0 * np.cos(angle)).tolist(), (5000.0 * np.sin(angle)).tolist())
    path.write_text("x_m,y_m,vx_mps\n" + "\n".join(f"{x},{y},3" for x, y in rows))
    line = refused(capsys, "race", "--track", path, "--output", tmp_path / "a.bag")
    assert "expected a lap of at most 5000 m, got 31416 m: is it in meters?" in line


def test_an_output_may_be_called_like_a_shipped_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["race", "--laps", "1", "--controller", "map", "--output", "map"]) == 0
    assert (tmp_path / "map").is_file()


def test_race_refuses_a_folder_that_is_not_there(tmp_path, capsys):
    assert "does not exist" in refused(capsys, "race", "--output", tmp_path / "no" / "a.bag")


# -- evaluate ------------------------------------------------------------------------------------


def test_evaluate_writes_what_it_prints(bags, tmp_path, capsys):
    paths = [str(path) for path in bags.values()]
    table, report, plots = tmp_path / "l.csv", tmp_path / "l.json", tmp_path / "plots"
    files = ["--csv", str(table), "--json", str(report), "--plots", str(plots)]
    assert main(["evaluate", *paths, *files]) == 0
    printed = capsys.readouterr().out
    assert "map_0.7" in printed and "out-lap" in printed

    laps = pd.read_csv(table)
    assert list(laps.columns[:8]) == [
        "bag",
        "lap",
        "lap_time_s",
        "rms_lateral_error_m",
        "mean_abs_lateral_error_m",
        "max_abs_lateral_error_m",
        "valid",
        "reason",
    ]
    runs = json.loads(report.read_text())["runs"]
    assert [run["bag"] for run in runs] == paths
    for run in runs:
        assert run["summary"]["laps_completed"] == 2
        valid = [lap for lap in run["laps"] if lap["valid"]]
        read = laps[(laps["bag"] == run["bag"]) & laps["valid"]]
        assert [lap["lap_time_s"] for lap in valid] == pytest.approx(list(read["lap_time_s"]))
    ours, theirs = (run["summary"]["mean_rms_lateral_error_m"] for run in runs)
    assert ours < 0.3 * theirs
    names = {path.name for path in plots.iterdir()}
    assert names == {"boxes.png", "difference.png"} | {
        f"{name}_0.7_{kind}.png" for name in bags for kind in ("laps", "speed", "error")
    }


def test_evaluate_refuses(bags, tmp_path, capsys):
    bag = bags["map"]
    assert "no such file" in refused(capsys, "evaluate", tmp_path / "none.bag").lower()
    (tmp_path / "text.bag").write_text("hello\n" * 100)
    assert "text.bag" in refused(capsys, "evaluate", tmp_path / "text.bag")
    (tmp_path / "empty.bag").write_bytes(b"")
    assert "empty.bag" in refused(capsys, "evaluate", tmp_path / "empty.bag")
    assert "/nothing" in refused(capsys, "evaluate", bag, "--pose-topic", "/nothing")
    assert "club" in refused(capsys, "evaluate", bag, "--raceline", "club")
    assert "no pose on /" in refused(capsys, "evaluate", bag, "--pose-topic", "")
    assert "'': expected the name" in refused(capsys, "evaluate", bag, "--raceline", "")
    assert "'': expected the name" in refused(capsys, "evaluate", "")
    assert "Is a directory" in refused(capsys, "evaluate", tmp_path)
    assert "start line" in refused(capsys, "evaluate", bag, "--start-line", "nan")
    assert "max-deviation" in refused(capsys, "evaluate", bag, "--max-deviation", "0")
    path = tmp_path / "run.csv"
    path.write_text("t,x,y\n0,0,0\n1,1,0\n")
    assert "no raceline" in refused(capsys, "evaluate", path)
    assert refused(capsys, "evaluate", bag, "--csv", tmp_path / "no" / "laps.csv")


def test_outputs_never_destroy_what_was_recorded(bags, tmp_path, capsys):
    ours, theirs = (tmp_path / f"{name}.bag" for name in ("ours", "theirs"))
    for path in (ours, theirs):
        shutil.copy(str(bags["map"]), str(path))
    before = ours.read_bytes()
    assert "an input" in refused(capsys, "evaluate", ours, "--csv", ours)
    assert "another output" in refused(
        capsys, "evaluate", ours, "--csv", tmp_path / "a", "--json", tmp_path / "a"
    )
    shutil.copy(str(ours), str(tmp_path / "unnamed"))
    line = refused(capsys, "evaluate", theirs, "--csv", tmp_path / "unnamed")
    assert "is a bag, which would be lost" in line
    car = tmp_path / "car.yaml"
    shutil.copy(str(find_config("vehicles", "nuc4", (".yaml",))), str(car))
    text = car.read_text()
    assert "an input" in refused(capsys, "lookup", "generate", "--vehicle", car, "--output", car)
    assert "an input" in refused(capsys, "race", "--vehicle", car, "--output", car)
    assert "name of a file" in refused(capsys, "race", "--output", ".")
    assert (ours.read_bytes(), car.read_text()) == (before, text)


def test_runs_on_different_tracks_have_no_difference(bags, tmp_path, capsys):
    other = tmp_path / "club.bag"
    arguments = ["--laps", "1", "--track", "club", "--speed-scale", "0.5", "--output", str(other)]
    assert main(["race", *arguments]) == 0
    assert main(["evaluate", str(bags["map"]), str(other), "--plots", str(tmp_path / "two")]) == 0
    assert "no difference.png: club: expected the raceline" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "two").iterdir()}
    assert "boxes.png" in names and "difference.png" not in names


def test_one_bad_recording_does_not_hold_up_the_others(bags, tmp_path, capsys):
    table = tmp_path / "laps.csv"
    paths = [str(bags["map"]), str(tmp_path / "none.bag"), str(bags["pure_pursuit"])]
    assert main(["evaluate", *paths, "--csv", str(table)]) == 1
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1 and "none.bag" in printed.err
    assert set(pd.read_csv(table)["bag"]) == {paths[0], paths[2]}


def test_the_report_tells_the_raceline_that_was_used(bags, tmp_path, capsys):
    assert main(["evaluate", str(bags["map"]), "--raceline", "reference"]) == 0
    printed = capsys.readouterr().out
    assert "raceline: reference; heading" in printed and "/global_waypoints" not in printed
    assert main(["evaluate", str(bags["map"]), "--reverse"]) == 0
    printed = capsys.readouterr().out
    assert "raceline reversed" in printed and "0 laps counted" in printed


def test_driven_the_other_way_round(shared_data, tmp_path):
    folder = shared_data / "laps" / "ipz20"
    run = str(min(folder.glob("*.csv.gz")))
    reports = []
    for raceline, option in (("IPZ20_wp.csv", []), ("IPZ20_wp_reverse.csv", ["--reverse"])):
        report = tmp_path / f"{raceline}.json"
        arguments = ["--raceline", str(folder / raceline), "--json", str(report), *option]
        assert main(["evaluate", run, "--max-deviation", "1", *arguments]) == 0
        reports.append(json.loads(report.read_text())["runs"][0]["summary"])
    assert reports[0]["laps_completed"] == reports[1]["laps_completed"] == 3


def test_a_truncated_bag_gives_the_laps_it_still_has(bags, tmp_path, capsys):
    data = bags["map"].read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(data[: int(0.6 * len(data))])
    assert main(["evaluate", str(path), "--json", str(tmp_path / "l.json")]) == 0
    (run,) = json.loads((tmp_path / "l.json").read_text())["runs"]
    assert any("messages" in note for note in run["notes"])
    assert run["laps"]


def test_the_hangar_recording_as_it_is(shared_data, tmp_path):
    recording = shared_data / "recordings" / "hangar_map_12laps.bag"
    assert main(["evaluate", str(recording), "--csv", str(tmp_path / "l.csv")]) == 0
    laps = pd.read_csv(tmp_path / "l.csv")
    laps = laps[laps["valid"]]
    assert len(laps) == 11
    assert laps["lap_time_s"].between(5.34, 5.39).all()
    assert laps["rms_lateral_error_m"].between(0.10, 0.12).all()


def test_real_laps_from_csv(shared_data, tmp_path):
    folder = shared_data / "laps" / "ipz20"
    runs = sorted(str(path) for path in folder.glob("*.csv.gz"))
    raceline, report = str(folder / "IPZ20_wp.csv"), tmp_path / "l.json"
    assert main(["evaluate", *runs, "--raceline", raceline, "--json", str(report)]) == 0
    runs = json.loads(report.read_text())["runs"]
    times = [lap["lap_time_s"] for run in runs for lap in run["laps"] if lap["lap_time_s"]]
    assert len(times) == 10
    assert min(times) > 6.6 and max(times) < 9.4


def test_names_of_runs_keep_their_dots():
    assert run_names(["a/map_0.7.bag", "b/pp.csv.gz", "c.bag.active"]) == ["map_0.7", "pp", "c"]
    assert run_names(["a/x.bag", "b/x.bag"]) == ["a/x.bag", "b/x.bag"]
    assert run_names(["/m/n/a/x.bag", "/m/n/b/x.bag"]) == ["a/x.bag", "b/x.bag"]
    assert run_names(["/m/n/x.bag", "/m/n/x.bag"]) == ["x.bag", "x.bag"]


# -- lookup --------------------------------------------------------------------------------------


def test_generated_table_checks_against_its_vehicle(tmp_path, capsys):
    path = tmp_path / "t.csv"
    arguments = ["--vehicle", "nuc4", "--output", str(path), "--published-grid"]
    assert main(["lookup", "generate", *arguments]) == 0
    speeds, angles = published_grid()
    table = load_table(path)
    assert np.array_equal(table.speeds, speeds) and np.array_equal(table.angles, angles)
    assert main(["lookup", "check", str(path), "--vehicle", "nuc4"]) == 0
    assert "largest difference 0.00e+00" in capsys.readouterr().out
    assert "not a table of SIM" in refused(capsys, "lookup", "check", path, "--vehicle", "sim")


def test_a_table_may_differ_from_its_vehicle_as_much_as_tires_do(tmp_path, capsys):
    text = find_config("vehicles", "nuc4", (".yaml",)).read_text(encoding="utf-8")
    for mu in ("0.995", "0.98"):
        car, path = tmp_path / f"{mu}.yaml", tmp_path / f"{mu}.csv"
        car.write_text(re.sub(r"(?m)^mu: \S+", f"mu: {mu}", text), encoding="utf-8")
        assert main(["lookup", "generate", "--vehicle", str(car), "--output", str(path)]) == 0
        check = ["lookup", "check", str(path), "--vehicle", "nuc4"]
        if mu == "0.995":
            assert main(check) == 0
            assert "made from other parameters" in capsys.readouterr().out
        else:
            assert "not a table of NUC4: off by 0.1" in refused(capsys, *check)


def test_table_is_drawn(tmp_path):
    arguments = ["--vehicle", "sim", "--output", str(tmp_path / "t.csv"), "--v-max", "8"]
    plots = tmp_path / "plots"
    assert main(["lookup", "generate", *arguments, "--linear", "--plots", str(plots)]) == 0
    names = ["lookup_curves.png", "lookup_surface.png"]
    assert sorted(path.name for path in plots.iterdir()) == names


def test_published_tables_follow_from_the_shipped_vehicles(shared_data, capsys):
    for vehicle, file in (("nuc4", "NUC4_pacejka"), ("sim", "SIM_linear")):
        path = shared_data / "vehicles" / f"{file}_lookup_table.csv"
        assert main(["lookup", "check", str(path), "--vehicle", vehicle]) == 0


def test_lookup_refuses(tmp_path, capsys):
    output = ["--output", tmp_path / "t.csv"]
    assert "nowhere" in refused(capsys, "lookup", "generate", "--vehicle", "nowhere", *output)
    line = refused(capsys, "lookup", "generate", "--vehicle", "nuc4", "--v-max", "0", *output)
    assert "--v-max" in line
    (tmp_path / "bad.csv").write_text("0,1,2\n0,0,x\n")
    assert "bad.csv:2" in refused(capsys, "lookup", "check", tmp_path / "bad.csv")


# -- the program ---------------------------------------------------------------------------------


def test_wrong_arguments_exit_with_2(capsys):
    for arguments in ([], ["nothing"], ["race"], ["lookup"], ["evaluate"]):
        with pytest.raises(SystemExit) as exit_code:
            main(arguments)
        assert exit_code.value.code == 2


def program(*arguments, **options):
    """Run the command line as a process."""
    command = [sys.executable, "-m", "map_racing", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.run(command, **{"stdout": pipe, "stderr": pipe, "check": False, **options})


def test_names_that_are_not_utf8(bags, tmp_path):
    name = b"r\xfcn.bag"
    path = os.fsdecode(os.fsencode(str(tmp_path)) + b"/" + name)
    shutil.copy(str(bags["map"]), path)
    files = ["--csv", tmp_path / "l.csv", "--json", tmp_path / "l.json", "--plots", tmp_path / "p"]
    done = program("evaluate", path, *files)
    assert (done.returncode, done.stderr) == (0, b"")
    assert name in (tmp_path / "l.csv").read_bytes()
    assert json.loads((tmp_path / "l.json").read_text())["runs"][0]["bag"] == path
    assert len(list((tmp_path / "p").iterdir())) == 4


def test_figures_of_runs_with_strange_names(bags, tmp_path):
    path = tmp_path / f"\u8d5b $\\frac$ {'long' * 40}.bag"
    shutil.copy(str(bags["map"]), str(path))
    done = program("evaluate", path, path, "--plots", tmp_path / "p")
    assert (done.returncode, done.stderr) == (0, b"")
    assert len(list((tmp_path / "p").iterdir())) == 5


def test_a_terminal_that_knows_no_umlauts(bags, tmp_path):
    path = tmp_path / "ru\u0308n_\u8d5b.bag"
    shutil.copy(str(bags["map"]), str(path))
    done = program("evaluate", path, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"n_\\u8d5b.bag" in done.stdout


def test_without_any_stream(bags, tmp_path):
    report = tmp_path / "l.json"
    command = f'exec "{sys.executable}" -m map_racing evaluate "$0" --json "$1" <&- >&- 2>&-'
    subprocess.run(["sh", "-c", command, str(bags["map"]), str(report)], check=True)
    assert json.loads(report.read_text())["runs"][0]["summary"]["laps_completed"] == 2


def test_an_interrupt_is_one_line_and_leaves_nothing(tmp_path):
    command = [sys.executable, "-m", "map_racing", "race", "--laps", "1000"]
    process = subprocess.Popen(
        [*command, "--output", str(tmp_path / "a.bag")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # A script may start the tests in the background, where interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    process.stdout.readline()  # it races now
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert (process.returncode, err) == (130, b"map-racing: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_too_little_memory_is_one_line(capsys, monkeypatch):
    def exhausted(_):
        raise MemoryError

    monkeypatch.setattr("map_racing.cli.lookup.load_table", exhausted)
    assert "not enough memory" in refused(capsys, "lookup", "check", "table.csv")


def test_installed_copy_finds_its_data(tmp_path):
    """What pip installs, without the source tree: command, packages and data files."""
    source = __file__[: __file__.index("/test/unit/")]
    copy = tmp_path / "source"
    ignore = shutil.ignore_patterns(".git", "results", "build", "*.egg-info", "test")
    shutil.copytree(source, str(copy), ignore=ignore)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*pip, "--target", str(tmp_path / "target"), str(copy)], check=True)
    code = (
        "from map_racing.cli import main; import map_racing, sys\n"
        f"assert map_racing.__file__.startswith({str(tmp_path / 'target')!r})\n"
        "sys.exit(main(['race', '--laps', '1', '--output', 'a.bag']))"
    )
    environment = {"PYTHONPATH": str(tmp_path / "target"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=str(tmp_path),
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # no progress bar where stderr is no terminal
    assert (tmp_path / "a.bag").is_file()
