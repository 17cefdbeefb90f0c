//! Finds PETSc and writes its Rust bindings; does nothing without the feature `petsc`.
//!
//! PETSc is looked for in `PETSC_DIR` (and `PETSC_ARCH`) when that is set, else by pkg-config.
//! Every place that was tried is printed when none of them has it.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    #[cfg(feature = "petsc")]
    if let Err(reason) = petsc::bind() {
        eprintln!("error: {reason}");
        std::process::exit(1);
    }
}

#[cfg(feature = "petsc")]
mod petsc {
    use std::path::{Path, PathBuf};
    use std::process::Command;
    use std::{env, fs, panic};

    const HEADER: &str = "src/petsc/wrapper.h";

    /// What becomes Rust: one safe method in `src/petsc` per line or two of these.
    const FUNCTIONS: &[&str] = &[
        "PetscInitialize",
        "PetscFinalize",
        "PetscPushErrorHandler",
        "PetscErrorMessage",
        "PetscOptions(HasHelp|SetValue|ClearValue|GetBool|GetReal|Used|LeftGet|LeftRestore)",
        "PetscFunctionListGet",
        "PetscLogStage(Register|Push|Pop)",
        "PetscSplitOwnership",
        "PetscContainer(Create|SetPointer|SetUserDestroy|Destroy)",
        "PetscObjectCompose",
        "PetscViewer(Create|SetType|FileSetMode|FileSetName|BinarySetSkipInfo|Destroy)",
        "Vec(Create|SetSizes|SetType|GetSize|GetArray|RestoreArray|GetArrayRead|RestoreArrayRead|Set|Norm|Copy|AYPX|Scale|View|Destroy)",
        "Mat(CreateSeqAIJWithArrays|CreateMPIAIJWithSplitArrays|GetSize|GetInfo|Mult|Norm|Transpose|IsSymmetric|MPIAIJGetSeqAIJ|View|Destroy)",
        "Mat(SetNullSpace|SetTransposeNullSpace|NullSpaceCreate|NullSpaceRemove|NullSpaceDestroy)",
        "KSP(InitializePackage|Create|Destroy|SetOptionsPrefix|SetType|GetType|GetPC|SetOperators|SetFromOptions|SetUp|Solve)",
        "KSP(SetTolerances|GetTolerances|SetPCSide|SetNormType|SetInitialGuessNonzero|GMRESSetRestart)",
        "KSP(GetConvergedReason|GetConvergedReasonString|GetIterationNumber|GetTotalIterations)",
        "PC(InitializePackage|SetType|GetType|KSPSetKSP|GetOperators|FactorGetMatrix|MGGetGridComplexity)",
        "tmpfile|fileno|fflush|fclose|dup|dup2",
    ];
    const TYPES: &[&str] = &["Petsc(Int|Scalar|Real|Bool|ErrorCode|ErrorType)", "FILE"];
    const VARIABLES: &[&str] = &[
        "PETSC_(DECIDE|DEFAULT|TRUE|FALSE|ERROR_INITIAL|VERSION_(MAJOR|MINOR|SUBMINOR))",
        "PetscTrFree",
        "(KSP|PC)List",
        "NORM_(2|FROBENIUS)",
        "PC_RIGHT",
        "KSP_NORM_UNPRECONDITIONED",
        "FILE_MODE_WRITE",
        "MAT_(INITIAL_MATRIX|GLOBAL_SUM)",
    ];

    pub fn bind() -> Result<(), String> {
        for name in ["PETSC_DIR", "PETSC_ARCH", "PKG_CONFIG_PATH", "MPICC"] {
            println!("cargo:rerun-if-env-changed={name}");
        }
        println!("cargo:rerun-if-changed={HEADER}");
        let mut include = find_petsc()?;
        include.extend(mpi_include());
        let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set; run this through cargo")?);
        let bindings = generate(&include)?;
        fs::write(out.join("petsc.rs"), bindings).map_err(|e| format!("cannot write the bindings: {e}"))
    }

    /// Include folders of PETSc; tells cargo how to link it.
    fn find_petsc() -> Result<Vec<PathBuf>, String> {
        let mut tried = Vec::new();
        if let Some(dir) = env::var_os("PETSC_DIR").filter(|dir| !dir.is_empty()) {
            let arch = env::var_os("PETSC_ARCH").unwrap_or_default();
            let root = PathBuf::from(dir);
            match from_prefix(&root, &root.join(arch)) {
                Ok(include) => return Ok(include),
                Err(reason) => tried.push(reason),
            }
        }
        for name in ["PETSc", "petsc"] {
            match pkg_config::Config::new().probe(name) {
                Ok(library) => return Ok(library.include_paths),
                Err(e) => tried.push(format!("pkg-config {name}: {}", e.to_string().trim())),
            }
        }
        Err(format!(
            "PETSc was not found.\n  - {}\nOn Debian or Ubuntu: apt install libpetsc-real-dev libclang-dev pkg-config\n\
             Elsewhere: set PETSC_DIR (and PETSC_ARCH) to a PETSc with real scalars and hypre.\n\
             Without PETSc: cargo build --no-default-features (WCSPH only).",
            tried.join("\n  - ").replace('\n', "\n    ")
        ))
    }

    /// A PETSc that `PETSC_DIR` points at: `root` holds the sources' headers, `build` what was compiled.
    fn from_prefix(root: &Path, build: &Path) -> Result<Vec<PathBuf>, String> {
        let include: Vec<PathBuf> = [build, root].iter().map(|p| p.join("include")).collect();
        let Some(header) = include.iter().map(|p| p.join("petscconf.h")).find(|p| p.exists()) else {
            return Err(format!(
                "PETSC_DIR: no include/petscconf.h under {} or {}",
                build.display(),
                root.display()
            ));
        };
        let scalar = fs::read_to_string(&header).unwrap_or_default();
        if scalar.contains("#define PETSC_USE_COMPLEX") {
            return Err(format!("PETSC_DIR: {} is a PETSc with complex scalars", build.display()));
        }
        let lib = build.join("lib");
        let names = ["petsc", "petsc_real", "petsc64_real"];
        let suffixes = ["so", "dylib", "a"];
        let name = names
            .iter()
            .find(|name| suffixes.iter().any(|suffix| lib.join(format!("lib{name}.{suffix}")).exists()))
            .ok_or_else(|| format!("PETSC_DIR: no libpetsc in {}", lib.display()))?;
        println!("cargo:rustc-link-search=native={}", lib.display());
        println!("cargo:rustc-link-lib={name}");
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
        Ok(include.into_iter().filter(|p| p.exists()).collect())
    }

    /// Include folders of MPI, asked from its compiler wrapper (Open MPI, then MPICH), then pkg-config.
    fn mpi_include() -> Vec<PathBuf> {
        let wrapper = env::var("MPICC").unwrap_or_else(|_| "mpicc".into());
        let ask = |flag: &str| {
            let answer = Command::new(&wrapper).arg(flag).output().ok().filter(|o| o.status.success())?;
            let text = String::from_utf8_lossy(&answer.stdout).into_owned();
            let paths: Vec<_> =
                text.split_whitespace().filter_map(|w| w.strip_prefix("-I")).map(PathBuf::from).collect();
            (!paths.is_empty()).then_some(paths)
        };
        ask("--showme:compile").or_else(|| ask("-show")).unwrap_or_else(|| {
            ["ompi", "mpich", "mpi"]
                .iter()
                .find_map(|name| pkg_config::Config::new().cargo_metadata(false).probe(name).ok())
                .map(|library| library.include_paths)
                .unwrap_or_default()
        })
    }

    fn generate(include: &[PathBuf]) -> Result<String, String> {
        let mut builder = bindgen::Builder::default()
            .header(HEADER)
            .clang_args(include.iter().map(|path| format!("-I{}", path.display())))
            // One MPI in the program: its types are rsmpi's, so that communicators pass between the two.
            .blocklist_type("MPI_Comm|ompi_communicator_t")
            .opaque_type("_IO_FILE")
            .prepend_enum_name(false)
            .layout_tests(false)
            .generate_comments(false);
        builder = FUNCTIONS.iter().fold(builder, |b, name| b.allowlist_function(name));
        builder = TYPES.iter().fold(builder, |b, name| b.allowlist_type(name));
        builder = VARIABLES.iter().fold(builder, |b, name| b.allowlist_var(name));
        // A missing libclang is a panic inside bindgen; here it becomes a sentence.
        panic::set_hook(Box::new(|_| {}));
        let outcome = panic::catch_unwind(panic::AssertUnwindSafe(|| builder.generate()));
        let _ = panic::take_hook();
        match outcome {
            Ok(Ok(bindings)) => Ok(bindings.to_string()),
            Ok(Err(e)) => Err(format!(
                "bindgen could not read {HEADER}: {e}\nOn Debian or Ubuntu: apt install libpetsc-real-dev libclang-dev"
            )),
            Err(_) => Err("bindgen found no libclang.\nOn Debian or Ubuntu: apt install libclang-dev".into()),
        }
    }
}
