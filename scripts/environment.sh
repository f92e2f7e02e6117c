# Sourced by demo, test, test_ros, test_browser and benchmark, in the checkout: make Python
# environments from whatever Python 3.8 or newer is installed.

# They are in $cache, not in the checkout: rosrun searches the whole folder of a package for
# executables, and this may be that folder, in a car's workspace. Deleting $cache is safe.
caches=${XDG_CACHE_HOME:-$HOME/.cache}/map_racing
cache=$caches/$(cksum <<<"$PWD" | cut -d ' ' -f 1)
if [ ! -d "$cache" ]; then
    # Also delete those of checkouts that no longer exist.
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

# make_venv PYTHON FOLDER: an environment with pip, even if Debian splits venv from Python.
make_venv() {
    local python=$1 folder=$2 site
    rm -rf "$folder"
    "$python" -m venv "$folder" >/dev/null 2>&1 && return
    rm -rf "$folder"
    "$python" -m virtualenv -q "$folder" >/dev/null 2>&1 && return
    rm -rf "$folder"
    # venv without ensurepip (python3-venv is missing), but with a pip that can install pip there.
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
    die "$python cannot make an environment; on Debian or Ubuntu: sudo apt install python3-venv"
}

# as_root COMMAND...: run as root if that needs no password.
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@" 2>/dev/null; fi
}

# find_uv: print the installer uv, which needs a tenth of pip's time: the one on PATH, or one that pip
# gets for all checkouts.
find_uv() {
    command -v uv && return
    [ -x "$caches/uv/bin/uv" ] ||
        "$(find_python)" -m pip install -q --disable-pip-version-check --target "$caches/uv" uv \
            >/dev/null 2>&1 || return
    printf '%s\n' "$caches/uv/bin/uv"
}

# ready NAME PYTHON PIP-ARGUMENT...: make the environment $cache/NAME and install into it; only
# again if the interpreter, the arguments or the project's metadata have changed.
ready() {
    local folder=$cache/$1 python=$2 wanted uv
    shift 2
    wanted=$("$python" -VV; echo "$PWD" "$@"; cat setup.py pyproject.toml)
    [ "$wanted" != "$(cat "$folder/ready" 2>/dev/null)" ] || return 0
    say "preparing $folder with $("$python" -V) ..."
    rm -rf "$folder"
    # Behind the nodes' tests, which drive in real time. Where uv cannot do it (it does not know
    # pip's settings, such as a mirror), pip does.
    uv=$(find_uv) && "$uv" venv -q --python "$python" "$folder" 2>/dev/null &&
        nice -n 10 "$uv" pip install -q --python "$folder/bin/python" pip "$@" 2>/dev/null || {
        make_venv "$python" "$folder"
        nice -n 10 "$folder/bin/python" -m pip install -q --no-compile \
            --disable-pip-version-check "$@" ||
            die "could not install the dependencies with pip (is there a network?)"
    }
    printf '%s\n' "$wanted" >"$folder/ready"
}

# ready_current: make the environment `current`, which tests, linter, site and the browser's tests
# share: three would get the same libraries. Modules are compiled when they are imported.
ready_current() {
    ready current "$(find_python)" -e '.[test,rivals,docs]' ruff==0.17.6 selenium
}
