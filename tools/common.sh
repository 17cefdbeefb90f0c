# What tools/run and tools/test share: the project folder, the packages, the MPI environment.
# To be sourced by bash; leaves the caller in the project folder.

set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A toolchain fresh from rustup may not be on the PATH of this shell yet.
if ! command -v cargo >/dev/null && [ -f "$HOME/.cargo/env" ]; then . "$HOME/.cargo/env"; fi
if ! command -v cargo >/dev/null; then
    echo "cargo is missing: install Rust from https://rustup.rs first" >&2
    exit 2
fi

# Threads are rayon's, one pool a rank: BLAS must not start its own on top.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# Open MPI in containers: run as root, on more ranks than cores, without ptrace permissions.
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
export OMPI_MCA_rmaps_base_oversubscribe=1
export OMPI_MCA_btl_vader_single_copy_mechanism=none

# Installs the Debian packages among "$@" that are missing.
install_packages() {
    local missing=() package
    for package in "$@"; do
        dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || missing+=("$package")
    done
    if [ ${#missing[@]} = 0 ]; then return; fi
    if ! command -v apt-get >/dev/null; then
        echo "no apt-get here: continuing in the hope that ${missing[*]} exist under other names" >&2
        return
    fi
    local as_root=()
    if [ "$(id -u)" != 0 ]; then as_root=(sudo); fi
    echo "installing ${missing[*]}"
    "${as_root[@]}" apt-get update -qq
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

# What building with all features needs; PETSC_DIR stands for a PETSc of one's own.
install_build_packages() {
    local petsc=(libpetsc-real-dev)
    if [ -n "${PETSC_DIR:-}" ]; then petsc=(); fi
    install_packages gcc g++ pkg-config libclang-dev openmpi-bin libopenmpi-dev "${petsc[@]}"
}
