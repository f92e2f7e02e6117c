"""Read and write small files."""

from __future__ import annotations

import json
import math
import os
import re
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Iterator

import yaml

from .errors import FileFormatError, MapRacingError

__all__ = [
    "for_json",
    "make_folder",
    "read_json",
    "read_yaml_mapping",
    "refuse_special",
    "replacing",
    "together",
    "unfinished",
    "write_json",
    "yaml_text",
]


def read_yaml_mapping(path: str | Path, what: str = "") -> dict:
    """Read a YAML file with one mapping.

    Parameters
    ----------
    path : str or pathlib.Path
    what : str, optional
        What the file should be, for the error, such as ``"a vehicle file"``.

    Returns
    -------
    dict

    Raises
    ------
    FileFormatError
        If it is something else; names file and line.
    """
    try:
        values = yaml.load(Path(path).read_text(encoding="utf-8"), _UniqueKeyLoader)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FileFormatError(f"{path}: expected YAML, found bytes that are not text") from None
    except RecursionError:
        raise FileFormatError(f"{path}: expected YAML: nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2020-13-45
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or "not readable"
        expected = f"{what} (YAML)" if what else "YAML"
        raise FileFormatError(f"{where}: expected {expected}: {problem}") from None
    if not isinstance(values, dict):
        expected = f"{what} (YAML)" if what else "keys and values"
        kind = type(values).__name__
        raise FileFormatError(f"{path}: expected {expected}, got {_IN_WORDS.get(kind, kind)}")
    return values


_IN_WORDS = {"NoneType": "nothing", "str": "a text", "list": "a list"}


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that reads 1e-3 as a number, as YAML 1.2 does.

    It refuses duplicate keys, and numbers that YAML 1.1 reads differently than they look: 0105,
    which is octal, and 1:30, which is 90.
    """

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            if not isinstance(key.value, str):
                continue
            if key.value in seen:
                problem = f"{key.value}: given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _decimal(kind):
    """Constructor for numbers of a kind, ``int`` or ``float``."""
    construct = getattr(yaml.SafeLoader, f"construct_yaml_{kind}")

    def checked(loader, node):
        if ":" in node.value or re.fullmatch(r"[-+]?0[0-9_]+", node.value):
            problem = f"{node.value}: expected a decimal number"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return construct(loader, node)

    return checked


for _kind in ("int", "float"):
    _UniqueKeyLoader.add_constructor(f"tag:yaml.org,2002:{_kind}", _decimal(_kind))


class _Dumper(yaml.SafeDumper):
    """Safe dumper that quotes texts which `_UniqueKeyLoader` would read as numbers: 12e4."""


for _kind in (_UniqueKeyLoader, _Dumper):
    _kind.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"),
        list("-+.0123456789"),
    )


def yaml_text(values: dict, **options: object) -> str:
    """YAML that `read_yaml_mapping` reads back unchanged; `options` are those of ``yaml.dump``."""
    return yaml.dump(values, Dumper=_Dumper, sort_keys=False, **options)


# Files that appear together: their temporary names by their final ones; None outside of `together`.
_waiting: ContextVar[dict | None] = ContextVar("waiting", default=None)


@contextmanager
def together() -> Iterator[None]:
    """Write files that belong together: they appear when all are complete, or none does.

    Until the end, what `replacing` and `unfinished` write within has temporary names; after an
    error existing files are unchanged. A group within a group is part of it.

    Raises
    ------
    MapRacingError
        If a file cannot be written.
    """
    if _waiting.get() is not None:
        yield
        return
    waiting: dict[Path, Path] = {}
    token = _waiting.set(waiting)
    try:
        yield
        for target, temporary in waiting.items():
            _appear(temporary, target, target)
    finally:
        _waiting.reset(token)
        for temporary in waiting.values():
            with suppress(OSError):
                temporary.unlink()


@contextmanager
def unfinished(path: str | Path) -> Iterator[Path]:
    """Temporary name in the folder of a file, under which it is written; renamed at the end.

    After an error the file is removed, and an existing one is unchanged. The target of a link is
    replaced.

    Parameters
    ----------
    path : str or pathlib.Path

    Raises
    ------
    MapRacingError
        If it cannot be renamed.
    """
    target = Path(os.path.realpath(str(path)))
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    waiting = _waiting.get()
    try:
        yield temporary
        if waiting is None:
            _appear(temporary, target, path)
        else:
            waiting[target] = temporary
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def _appear(temporary, target, path):
    try:
        os.replace(str(temporary), str(target))
    except OSError as error:
        raise MapRacingError(f"{path}: cannot write: {error.strerror or error}") from None


@contextmanager
def replacing(path: str | Path, binary: bool = False) -> Iterator[IO]:
    """Open a file for atomic writing: it appears under its name only when it is complete.

    It is written under a temporary name in the same folder and renamed at the end; after an error
    an existing file is unchanged. The target of a link is replaced; devices and pipes are written
    directly.

    Parameters
    ----------
    path : str or pathlib.Path
    binary : bool
        Write bytes instead of text.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    target = Path(os.path.realpath(str(path)))
    if not Path(path).name or target.is_dir():
        raise MapRacingError(f"{path}: cannot write: expected the name of a file")
    special = target.exists() and not target.is_file()
    # File names that are not UTF-8 are written unchanged.
    text = {"encoding": "utf-8", "errors": "surrogateescape", "newline": ""}
    mode, options = ("wb", {}) if binary else ("w", text)
    try:
        writing = nullcontext(target) if special else unfinished(path)
        with writing as name, open(name, mode, **options) as file:
            yield file
    except BrokenPipeError:  # writing to /dev/stdout with `| head`
        raise
    except OSError as error:
        raise MapRacingError(f"{path}: cannot write: {error.strerror or error}") from None


def write_json(path: str | Path, content: object, indent: int | None = 1) -> None:
    """Write content as JSON, see `for_json`; an existing file is replaced atomically.

    Parameters
    ----------
    path : str or pathlib.Path
    content : object
    indent : int, optional
        Spaces of indentation; None writes one line.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    with replacing(path) as file:
        # One dumps takes a tenth of the time of json.dump without indentation.
        file.write(json.dumps(for_json(content), indent=indent, allow_nan=False) + "\n")


def read_json(path: str | Path) -> object:
    """The content of a JSON file.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is something else.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError("nested too deeply") from None


def for_json(content: object) -> object:
    """Content that JSON can represent: numpy scalars as Python's, NaN and infinity as None."""
    if isinstance(content, dict):
        return {key: for_json(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [for_json(value) for value in content]
    if hasattr(content, "dtype"):
        content = content.item()
    return None if isinstance(content, float) and not math.isfinite(content) else content


def make_folder(path: str | Path) -> Path:
    """Make a folder with its parents, if it does not exist.

    Parameters
    ----------
    path : str or pathlib.Path

    Returns
    -------
    pathlib.Path

    Raises
    ------
    MapRacingError
        If it cannot be made.
    """
    if not str(path):  # such as an unset variable of the shell
        raise MapRacingError(f"{path!r}: expected the name of a folder")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MapRacingError(f"{folder}: cannot make the folder: {error.strerror}") from None
    return folder


def refuse_special(path: str | Path) -> None:
    """Refuse pipes and devices, because reading them may never end, and an empty name."""
    if not str(path):
        raise FileFormatError("'': expected the name of a file")
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileFormatError(f"{path}: expected a file, got a pipe or a device")
