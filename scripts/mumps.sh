#!/usr/bin/env bash
# Builds the sequential MUMPS from the source package of the distribution, with METIS, into .venv.
# Optional: low-rank factorisation needs it, because the library of the distribution groups the
# variables with SCOTCH and ends the process at random there. Running it again costs nothing.
#   MUMPS_PREFIX  folder to install into (.venv, where morembs finds it)
#   MUMPS_FLAGS   compiler flags (-O2), for example "-O3 -march=native" for this processor only
set -euo pipefail
cd "$(dirname "$0")/.."

# A compiler for C and Fortran, what unpacks a source package, METIS, BLAS and LAPACK.
packages=(gcc gfortran libc6-dev make dpkg-dev libmetis-dev libopenblas0-pthread)
prefix=${MUMPS_PREFIX:-.venv}
flags=${MUMPS_FLAGS:--O2}
library=$prefix/lib/libmumps_metis.so
stamp=$prefix/.morembs-mumps
# The release of the system decides the version of MUMPS.
fingerprint=$({ cat scripts/mumps.sh; cat /etc/os-release 2>/dev/null || true; echo "$flags"; } | sha256sum | cut -d' ' -f1)

if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$fingerprint" ] && [ -f "$library" ]; then
    exit 0
fi

fail() {
    printf 'mumps: %s\n' "$@" >&2
    exit 2
}
if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    fail "this builds the source package of Debian or Ubuntu, and there is no apt-get here"
fi
if ! mkdir -p "$prefix"; then
    fail "$prefix cannot be made; set MUMPS_PREFIX to a folder that can be written"
fi
prefix=$(cd "$prefix" && pwd)

missing=()
for package in "${packages[@]}"; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
install_packages() {
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    echo "mumps: installing Debian packages: ${missing[*]}"
    "${as_root[@]}" apt-get update -qq \
        && "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}
if [ ${#missing[@]} -gt 0 ] && ! install_packages; then
    fail "these Debian packages are missing and cannot be installed from here; add them and try again:" \
         "  sudo apt-get install ${missing[*]}"
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
log=$work/log

# Runs a step quietly; its last lines are shown when it fails.
step() {
    local words=$1
    shift
    if ! "$@" >>"$log" 2>&1; then
        tail -n 20 "$log" >&2
        fail "$words"
    fi
}

# The entries of apt as source entries, with indices of their own: neither the settings of the system
# nor its package lists change, and no rights are needed.
source_entries() {
    local list=/etc/apt/sources.list parts=/etc/apt/sources.list.d file
    eval "$(apt-config shell list Dir::Etc::sourcelist/f parts Dir::Etc::sourceparts/d)"
    mkdir "$work/entries"
    for file in "$list" "${parts%/}"/*.list; do
        [ ! -f "$file" ] || sed -nE 's/^[[:space:]]*deb(-src)?[[:space:]]+/deb-src /p' "$file"
    done | sort -u > "$work/entries/all.list"
    for file in "${parts%/}"/*.sources; do
        [ ! -f "$file" ] || sed -E 's/^[Tt]ypes:.*/Types: deb-src/' "$file" > "$work/entries/${file##*/}"
    done
    grep -qrE '^(deb-src |Types: deb-src)' "$work/entries"
}
apt_source() {
    apt-get -q -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$work/entries" \
        -o Dir::State::lists="$work/lists" -o Dir::Cache="$work/cache" "$@"
}
fetch() {
    mkdir -p "$work/lists/partial" "$work/cache/archives/partial"
    # Other entries may have no sources: only the one package counts.
    apt_source update || true
    (cd "$work" && apt_source source mumps)
    source=$(find "$work" -maxdepth 1 -type d -name 'mumps-*')
    [ -f "$source/src/dmumps_c.h" ] || [ -f "$source/include/dmumps_c.h" ]
}
source_entries || fail "apt has no entries in /etc/apt/sources.list or /etc/apt/sources.list.d to get the sources from"
echo "mumps: getting the source package of MUMPS"
step "the source package mumps cannot be had from the entries of apt" fetch

# Without OpenMP: on top of the threads of OpenBLAS it takes more than twice the time. 32-bit indices,
# 64-bit counts.
cat > "$source/Makefile.inc" <<'END'
LPORDDIR = $(topdir)/PORD/lib/
IPORD = -I$(topdir)/PORD/include/
LPORD = -L$(LPORDDIR) -lpord
ORDERINGSF = -Dpord -Dmetis
ORDERINGSC = $(ORDERINGSF)
IORDERINGSC = $(IPORD)
LORDERINGS = -lmetis $(LPORD)
PLAT =
LIBEXT = .a
LIBEXT_SHARED = .so
FPIC = -fPIC
FPIC_OPT = -fPIC
OUTC = -o
OUTF = -o
RM = rm -f
CC = gcc
FC = gfortran
FL = gfortran
AR = ar r # a space follows
RANLIB = ranlib
INCS = -I$(topdir)/libseq
LIBS = -L$(topdir)/libseq -lmpiseq
LIBSEQNEEDED = libseqneeded
CDEFS = -DAdd_
OPTF = $(FLAGS) -fallow-argument-mismatch
OPTC = $(FLAGS) -DPORD_INTSIZE64
END
# One library with nothing of it visible but its four entry points: it meets no other MUMPS or MPI that
# is loaded in the same process.
echo '{ global: smumps_c; dmumps_c; cmumps_c; zmumps_c; local: *; };' > "$work/exports"
compile() {
    local make=(make -j "$(nproc)" FLAGS="$flags") arithmetic
    mkdir -p "$source/lib" && "${make[@]}" -C "$source" prerequisites \
        && "${make[@]}" -C "$source/src" ../include/mumps_int_def.h \
        && "${make[@]}" -C "$source/src" ../lib/libmumps_common.a || return 1
    for arithmetic in s d c z; do
        "${make[@]}" -C "$source/src" ARITH=$arithmetic "../lib/lib${arithmetic}mumps.a" || return 1
    done
}
link() (
    cd "$source/lib" && gfortran -shared -o "$work/libmumps_metis.so" -Wl,-soname,libmumps_metis.so \
        -Wl,--version-script="$work/exports" -Wl,-Bsymbolic -Wl,-z,defs \
        -Wl,--whole-archive lib[sdcz]mumps.a libmumps_common.a -Wl,--no-whole-archive \
        libpord.a libmpiseq.a -lmetis -l:liblapack.so.3 -l:libblas.so.3 -lpthread -lm
)
echo "mumps: compiling ${source##*/}, which takes some minutes"
step "MUMPS could not be compiled" compile
step "MUMPS could not be linked" link

install_files() {
    local headers=({s,d,c,z}mumps_c mumps_int_def mumps_c_types mumps_compat)
    headers=("${headers[@]/#/$source/include/}")
    rm -f "$stamp" && install -d "$prefix/lib" "$prefix/include/mumps_seq" \
        && install -m 644 "${headers[@]/%/.h}" "$prefix/include/mumps_seq" \
        && install -m 755 "$work/libmumps_metis.so" "$prefix/lib"
}
step "MUMPS could not be installed into $prefix" install_files
echo "$fingerprint" > "$stamp"
echo "mumps: $library is ready"
