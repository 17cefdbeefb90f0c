/* All of PETSc that the crate uses; build.rs lists the names that become Rust. */
#include <petscksp.h>
#include <petscviewer.h>
#include <stdio.h>
#include <unistd.h>
