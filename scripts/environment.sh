# Sourced by demo, test, test_ros and benchmark, in the checkout: make Python environments out of
# whatever Python 3.8 or newer is here.

# What they make lies in $cache, not in the checkout: rosrun searches all of a package's folder for
# executables, and that may be this folder, in the workspace of a car. Deleting it is safe.
caches=${XDG_CACHE_HOME:-$HOME/.cache}/map_racing
cache=$caches/$(cksum <<<"$PWD" | cut -d ' ' -f 1)
if [ ! -d "$cache" ]; then
    # Those of checkouts that are gone go, too.
    for other in "$caches"/*/checkout; do
        [ ! -f "$other" ] || [ -d "$(cat "$other")" ] || rm -rf "${other%/checkout}"
    done
    mkdir -p "$cache"
    printf '%s\n' "$PWD" >"$cache/checkout"
fi

say() { printf '%s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

# find_python: print the first Python >= 3.8 ($PYTHON, then python3, then python3.N).
find_python() {
    local candidate
    for candidate in ${PYTHON:+"$PYTHON"} python3 python3.14 python3.13 python3.12 python3.11 \
        python3.10 python3.9 python3.8 python; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 8))' 2>/dev/null; then
            command -v "$candidate"
            return
        fi
    done
    die "map_racing needs Python 3.8 or newer, and found none (set PYTHON=/path/to/python3)"
}

# make_venv PYTHON FOLDER: an environment with pip, also where Debian splits venv from Python.
make_venv() {
    local python=$1 folder=$2 site
    rm -rf "$folder"
    "$python" -m venv "$folder" >/dev/null 2>&1 && return
    rm -rf "$folder"
    "$python" -m virtualenv -q "$folder" >/dev/null 2>&1 && return
    rm -rf "$folder"
    # venv without ensurepip (python3-venv is missing), but with a pip to put pip there.
    if "$python" -m pip --version >/dev/null 2>&1 &&
        "$python" -m venv --without-pip "$folder" >/dev/null 2>&1; then
        site=$("$folder/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
        "$python" -m pip install -q --target "$site" pip && return
    fi
    rm -rf "$folder"
    if as_root true && command -v apt-get >/dev/null; then
        say "installing python3-venv ..."
        { as_root apt-get -qq update && as_root apt-get -qq install -y python3-venv; } \
            >/dev/null </dev/null && "$python" -m venv "$folder" >/dev/null && return
    fi
    die "$python can make no environment; on Debian or Ubuntu: sudo apt install python3-venv"
}

# as_root COMMAND...: run as root where that needs no password.
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@" 2>/dev/null; fi
}

# ready NAME PYTHON PIP-ARGUMENT...: make the environment $cache/NAME and install into it, once; again
# when the interpreter, the arguments or the project's metadata have changed.
ready() {
    local folder=$cache/$1 python=$2 wanted
    shift 2
    wanted=$("$python" -VV; echo "$PWD" "$@"; cat setup.py pyproject.toml)
    if [ "$wanted" != "$(cat "$folder/ready" 2>/dev/null)" ]; then
        say "preparing $folder with $("$python" -V) ..."
        make_venv "$python" "$folder"
        "$folder/bin/python" -m pip install -q --disable-pip-version-check "$@" ||
            die "could not install the dependencies with pip (is there a network?)"
        printf '%s\n' "$wanted" >"$folder/ready"
    fi
}

# ready_current: make the environment `current`. Tests, linter, site and the browser's tests share
# it: each of their own would install the same libraries. What is imported is compiled then.
ready_current() {
    ready current "$(find_python)" --no-compile -e '.[test,rivals,docs]' ruff==0.17.6 selenium
}
