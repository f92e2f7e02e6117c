"""Files that a command writes never replace its inputs or recordings."""

import shutil

from map_racing.cli.figures import remove_stale
from map_racing.resources import find_config


def test_outputs_never_destroy_what_was_recorded(bags, tmp_path, refused):
    ours, theirs = (tmp_path / f"{name}.bag" for name in ("ours", "theirs"))
    for path in (ours, theirs):
        shutil.copy(str(bags["map"]), str(path))
    before = ours.read_bytes()
    assert "an input" in refused("evaluate", ours, "--csv", ours)
    assert "another output" in refused(
        "evaluate", ours, "--csv", tmp_path / "a", "--json", tmp_path / "a"
    )
    shutil.copy(str(ours), str(tmp_path / "unnamed"))
    line = refused("evaluate", theirs, "--csv", tmp_path / "unnamed")
    assert "is a bag, which would be overwritten" in line
    car = tmp_path / "car.yaml"
    shutil.copy(str(find_config("vehicles", "nuc4", (".yaml",))), str(car))
    text = car.read_text()
    assert "an input" in refused("lookup", "generate", "--vehicle", car, "--output", car)
    assert "an input" in refused("race", "--vehicle", car, "--output", car)
    assert "name of a file" in refused("race", "--output", ".")
    assert (ours.read_bytes(), car.read_text()) == (before, text)


def test_outputs_of_a_call_appear_together(bags, tmp_path, refused, full_disk):
    full_disk(".json")
    table, report = tmp_path / "laps.csv", tmp_path / "laps.json"
    line = refused("evaluate", bags["map"], "--csv", table, "--json", report)
    assert "laps.json: cannot write: No space left on device" in line
    full_disk("speed.png")
    line = refused("evaluate", bags["map"], "--plots", tmp_path / "figures")
    assert "speed.png: cannot write: No space left on device" in line
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.name for path in left if not path.name.endswith("_laps.png")] == []


def test_only_own_figures_of_earlier_calls_are_removed(tmp_path):
    for name in ("run_1.png", "run_12.png", "run_notes.png", "run_1_mine.png", "my_run_1.png"):
        (tmp_path / name).write_text("")
    remove_stale(tmp_path, r"run_\d+\.png", ["run_1.png"])
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"run_1.png", "run_notes.png", "run_1_mine.png", "my_run_1.png"}
