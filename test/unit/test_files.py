"""Small files: errors are one line with the place, and replacing is all or nothing."""

import math
import os
import stat

import numpy as np
import pytest

from map_racing.errors import FileFormatError, MapRacingError
from map_racing.files import read_yaml_mapping, replacing, together, write_json, yaml_text


def test_reads_a_mapping(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("# a car\nm: 3.5\nname: \u00dcno\n", encoding="utf-8")
    assert read_yaml_mapping(path) == {"m": 3.5, "name": "\u00dcno"}
    assert read_yaml_mapping(str(path)) == read_yaml_mapping(path)


@pytest.mark.parametrize(
    "content, expected",
    [
        (b"", "expected keys and values, got nothing"),
        (b"# nothing but prose\n", "expected keys and values, got nothing"),
        (b"- 1\n- 2\n", "expected keys and values, got a list"),
        (b"just a text\n", "expected keys and values, got a text"),
        (b"a: 1\nb: [1, 2\nc: 3\n", ":3: expected YAML"),
        (b"a: 1\nb: 2: 3\n", ":2: expected YAML"),
        (b"a: 1\n\tb: 2\n", ":2: expected YAML"),
        (b"a: !!python/object:os.system x\n", ":1: expected YAML"),
        (b"a: 1\x00\n", "expected YAML"),
        (b"a: 1\nb: 2\na: 3\n", ":3: expected YAML: a: given twice"),
        (b"a: 1\nseeds: [1, 0105]\n", ":2: expected YAML: 0105: expected a decimal number"),
        (b"lap: 1:30\n", ":1: expected YAML: 1:30: expected a decimal number"),
        (b"s: {a: 1, a: 2}\n", ":1: expected YAML: a: given twice"),
        (b"? [a, b]\n: 1\n", ":1: expected YAML: found unhashable key"),
        (b"{a: 1}: 1\n", ":1: expected YAML: found unhashable key"),
        (b"[" * 3000, "nested too deeply"),
        (b"a: 2020-13-45\n", "expected YAML"),
        (b"\xff\xfe\x00\x01", "found bytes that are not text"),
    ],
)
def test_refuses_what_is_no_mapping(tmp_path, content, expected):
    path = tmp_path / "broken.yaml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_yaml_mapping(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and expected in message and "\n" not in message


def test_numbers_with_exponent_are_numbers(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("a: 1e-3\nb: [4.7e2, -2E3, .5e+1, 1.0e-3]\nc: 1e\nd: e3\ne: 1e-3 m\n")
    assert read_yaml_mapping(path) == {
        **{"a": 1e-3, "b": [470.0, -2000.0, 5.0, 1e-3]},
        **{"c": "1e", "d": "e3", "e": "1e-3 m"},
    }


def test_texts_that_look_like_numbers_are_read_back_as_texts(tmp_path):
    path = tmp_path / "car.yaml"
    values = {"name": "1e3", "hash": "123456e78901", "old": "0105", "m": 1e-5, "n": 3}
    path.write_text(yaml_text(values))
    assert read_yaml_mapping(path) == values


def test_refuses_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileFormatError, match=r"gone\.yaml: cannot read: No such file"):
        read_yaml_mapping(tmp_path / "gone.yaml")
    with pytest.raises(FileFormatError, match="cannot read: Is a directory"):
        read_yaml_mapping(tmp_path)


def test_a_file_appears_only_when_it_is_complete(tmp_path):
    path = tmp_path / "table.csv"
    with replacing(path) as file:
        file.write("0,1\n")
        file.flush()
        assert not path.exists()
    assert path.read_bytes() == b"0,1\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_an_existing_file_is_replaced(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with replacing(str(path)) as file:
        file.write("new \u03b1")
    assert path.read_text(encoding="utf-8") == "new \u03b1"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, MapRacingError])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(error), replacing(path) as file:
        file.write("half a ta")
        raise error
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_what_cannot_be_written_is_named(tmp_path):
    missing = tmp_path / "no" / "table.csv"
    expected = r"table\.csv: cannot write: No such file"
    with pytest.raises(MapRacingError, match=expected), replacing(missing) as file:
        file.write("x")
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(MapRacingError, match="folder: cannot write"), replacing(folder) as file:
        file.write("x")
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder"]


def test_a_link_stays_a_link(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    with replacing(link) as file:
        file.write("new")
    assert link.is_symlink() and target.read_text() == "new"


def test_a_pipe_is_written_to_as_it_is(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(str(pipe))
    reader = os.open(str(pipe), os.O_RDONLY | os.O_NONBLOCK)
    try:
        with replacing(pipe) as file:
            file.write("through")
        assert os.read(reader, 100) == b"through"
        assert stat.S_ISFIFO(os.stat(str(pipe)).st_mode)
    finally:
        os.close(reader)


def test_errors_are_one_line_whatever_they_name():
    assert str(MapRacingError("a\nb.yaml: c\r\nd")) == "a b.yaml: c d"


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_refuses_what_is_no_file_name(path):
    with pytest.raises(MapRacingError, match="expected the name of a file"), replacing(path):
        pass


def test_bytes_appear_only_when_they_are_complete(tmp_path):
    path = tmp_path / "race.bag"
    with replacing(path, binary=True) as file:
        file.write(b"\x00\xff\r\n")
        assert not path.exists()
    assert path.read_bytes() == b"\x00\xff\r\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["race.bag"]


def test_files_that_belong_together_appear_together(tmp_path):
    with together():
        with replacing(tmp_path / "table.csv") as file:
            file.write("0,1")
        with together(), replacing(tmp_path / "table.meta.yaml") as file:
            file.write("l_wb: 0.3")
        with replacing(tmp_path / "table.csv") as file:
            file.write("0,2")
        assert all(entry.name.startswith(".") for entry in tmp_path.iterdir())
    assert (tmp_path / "table.csv").read_text() == "0,2"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["table.csv", "table.meta.yaml"]
    write_json(tmp_path / "alone.json", {})
    assert (tmp_path / "alone.json").exists()


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, MapRacingError])
def test_after_an_error_none_of_the_files_appears(tmp_path, error):
    (tmp_path / "b.txt").write_text("old")
    with pytest.raises(error), together():
        for name in ("a.txt", "b.txt", "c.txt"):
            with replacing(tmp_path / name) as file:
                file.write("new")
                if name == "c.txt":
                    raise error
    assert [entry.name for entry in tmp_path.iterdir()] == ["b.txt"]
    assert (tmp_path / "b.txt").read_text() == "old"


def test_a_name_that_cannot_be_taken_is_told(tmp_path):
    with pytest.raises(MapRacingError, match=r"a\.txt: cannot write: "), together():
        with replacing(tmp_path / "a.txt") as file:
            file.write("new")
        (tmp_path / "a.txt").mkdir()
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_json_has_no_nan_and_no_numpy(tmp_path):
    path = tmp_path / "a.json"
    content = {"a": [math.nan, math.inf, np.float64(0.1)], "b": (np.int64(3), np.bool_(True), "x")}
    write_json(path, {"nested": content, "none": None}, indent=None)
    assert path.read_text() == (
        '{"nested": {"a": [null, null, 0.1], "b": [3, true, "x"]}, "none": null}\n'
    )
    write_json(path, [1])
    assert path.read_text() == "[\n 1\n]\n"


@pytest.mark.parametrize("place", ["", "missing/a.json"])
def test_json_that_cannot_be_written(tmp_path, place):
    with pytest.raises(MapRacingError, match="cannot write"):
        write_json(tmp_path / place, {})
    assert list(tmp_path.iterdir()) == []


def test_json_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
