//! Faults from outside: killed runs, folders that vanish, disks that fill up, ranks that die; and runs that must repeat themselves.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use crate::common::{bits, command, done, newest_state, run, sentence};
use sphpetsc::output::checkpoint::{self, Reader};
use sphpetsc::output::vtk;

/// A dam break of 200 particles that writes as often as it can; with a scheme that every build has.
const BUSY: &str = "dam_break_2d --spacing 0.02 --scheme wcsph --until 0.6 --set output.particles=0.005 \
                    --set output.checkpoint=0.005 --quiet";

/// Everything in the newest state of a run, bit by bit.
fn state(folder: &Path) -> BTreeMap<String, Vec<u64>> {
    bits(&newest_state(folder))
}

fn start(folder: &Path, line: &str) -> Child {
    command(folder, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until it is so, or the test fails.
fn wait(what: &str, mut until: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !until() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what} did not come");
        sleep(Duration::from_millis(2));
    }
}

/// Every file that a run has finished is whole: what carries a final name can be read.
fn assert_whole(folder: &Path) {
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for path in fs::read_dir(next).unwrap().map(|entry| entry.unwrap().path()) {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            match path.extension().and_then(|extension| extension.to_str()) {
                _ if path.is_dir() => folders.push(path),
                _ if name.starts_with('.') => assert!(name.ends_with(".tmp"), "{name}"),
                Some("ckpt") => drop(Reader::load(&path).unwrap()),
                Some("vtp") => drop(vtk::read_vtp(&path).unwrap()),
                Some("pvd") => drop(vtk::snapshots(&path).unwrap()),
                Some("json") => {
                    drop(serde_json::from_slice::<serde_json::Value>(&fs::read(&path).unwrap()).unwrap())
                }
                Some("toml") => {
                    drop(fs::read_to_string(&path).unwrap().parse::<toml_edit::DocumentMut>().unwrap())
                }
                Some("csv") => {
                    assert!(fs::read_to_string(&path).unwrap().ends_with('\n'), "{name} has a torn row")
                }
                _ => {}
            }
        }
    }
}

/// The same state, byte for byte, from the same run on any number of threads.
fn repeats(line: &str) {
    let folder = tempfile::tempdir().unwrap();
    let mut states = vec![];
    for (k, threads) in [1, 1, 2, 5].into_iter().enumerate() {
        done(&folder, &format!("{line} --quiet --threads {threads} --out run{k}"));
        states.push(state(&folder.path().join(format!("run{k}"))));
    }
    assert!(states[0]["position"].len() > 100);
    for other in &states[1..] {
        assert!(other == &states[0], "{line}: another state on other threads");
    }
}

#[test]
#[cfg(feature = "petsc")]
fn isph_repeats_itself_on_any_number_of_threads() {
    repeats("dam_break_2d --spacing 0.01 --until 0.4");
    repeats("dam_break_3d_sliding --spacing 0.08 --until 0.3 --set output.checkpoint=0.1");
}

#[test]
fn wcsph_repeats_itself_on_any_number_of_threads() {
    repeats("dam_break_2d --spacing 0.01 --until 0.35 --scheme wcsph");
    repeats("debris --spacing 0.02 --until 0.1 --scheme wcsph");
}

/// Kills a run at any moment, again and again, and goes on with it: nothing is torn, nothing is lost, and the end is that of a run
/// that nobody disturbed. `SPHPETSC_KILLS=50` does it so many times.
#[test]
fn a_run_killed_at_any_moment_goes_on() {
    let kills = std::env::var("SPHPETSC_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(5);
    let folder = tempfile::tempdir().unwrap();
    let whole = Instant::now();
    done(&folder, &format!("{BUSY} --out whole"));
    let longest = whole.elapsed();
    let expected = state(&folder.path().join("whole"));
    let mut seed = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as u64 | 1;
    println!("seed {seed}");
    let mut random = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    let parts = folder.path().join("parts");
    let mut done_before = 0;
    for _ in 0..kills {
        let newest = |parts: &Path| checkpoint::latest(&parts.join("checkpoint")).unwrap();
        let line = match newest(&parts) {
            Some(_) => "--resume parts --quiet".to_owned(),
            None => format!("{BUSY} --out parts{}", if parts.exists() { " --force" } else { "" }),
        };
        let mut child = start(folder.path(), &line);
        sleep(longest.mul_f64(random()));
        if child.try_wait().unwrap().is_some() {
            // Came to its end: the next one starts afresh.
            assert!(state(&parts) == expected, "another end");
            fs::remove_dir_all(&parts).unwrap();
            done_before = 0;
            continue;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        if parts.exists() {
            assert_whole(&parts);
            if let Some(path) = newest(&parts) {
                let step = Reader::load(&path).unwrap().u64("step").unwrap()[0];
                assert!(step >= done_before, "a checkpoint got lost");
                done_before = step;
            }
        }
    }
    if checkpoint::latest(&parts.join("checkpoint")).unwrap().is_some() {
        done(&folder, "--resume parts --quiet");
        assert!(state(&parts) == expected, "another end");
        let left = fs::read_dir(&parts)
            .unwrap()
            .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().ends_with(".tmp"));
        assert_eq!(left.count(), 0, "temporary files stay behind");
    }
}

#[test]
fn a_signal_asks_for_a_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let line = "dam_break_2d --spacing 0.01 --scheme wcsph --until 100 --set output.checkpoint=0 --out out";
    let mut child = start(folder.path(), line);
    wait("the first row", || out.join("history.csv").exists());
    sleep(Duration::from_millis(200));
    assert!(checkpoint::latest(&out.join("checkpoint")).unwrap().is_none());
    let signal = |name: &str| Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
    assert!(signal("-USR1").success());
    wait("the checkpoint", || checkpoint::latest(&out.join("checkpoint")).unwrap().is_some());
    assert!(child.try_wait().unwrap().is_none(), "the run goes on");
    child.kill().unwrap();
    child.wait().unwrap();
    done(&folder, "--resume out --until 0.05 --quiet");
}

#[test]
fn a_folder_that_vanishes_ends_the_run_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut child = start(folder.path(), &format!("{BUSY} --out out"));
    wait("the first checkpoint", || checkpoint::latest(&out.join("checkpoint")).unwrap_or(None).is_some());
    // The run may write a file while the folder goes.
    wait("the end of the folder", || fs::remove_dir_all(&out).is_ok() || !out.exists());
    wait("the end of the run", || child.try_wait().unwrap().is_some());
    let said = sentence(&child.wait_with_output().unwrap(), 1);
    assert!(said.contains("out"), "{said}");
}

/// A disk of 1 MB of its own, as long as it lives.
struct Disk(PathBuf);

impl Disk {
    /// None, and said so, without the right to mount.
    fn mount(folder: &Path) -> Option<Self> {
        let disk = Self(folder.join("disk"));
        fs::create_dir(&disk.0).unwrap();
        let is_mounted = mount(&["-t", "tmpfs", "-o", "size=1m", "tmpfs"], &disk.0);
        if !is_mounted {
            eprintln!("skipped: needs the right to mount a small disk");
        }
        is_mounted.then_some(disk)
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        Command::new("umount").arg(&self.0).status().ok();
    }
}

fn mount(words: &[&str], at: &Path) -> bool {
    Command::new("mount").args(words).arg(at).output().is_ok_and(|output| output.status.success())
}

#[test]
fn a_full_disk_ends_the_run_in_a_sentence_and_keeps_what_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::mount(folder.path()) else { return };
    let said = sentence(&run(&folder, &format!("{BUSY} --out disk/out")), 1);
    assert!(said.contains("disk") && said.to_lowercase().contains("space"), "{said}");
    let out = disk.0.join("out");
    Reader::load(&checkpoint::latest(&out.join("checkpoint")).unwrap().expect("one from before")).unwrap();
    assert_whole(&out);
}

#[test]
fn a_read_only_disk_is_refused_before_the_first_step() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::mount(folder.path()) else { return };
    let line = BUSY.replace("--until 0.6", "--until 0.02");
    done(&folder, &format!("{line} --out disk/out"));
    assert!(mount(&["-o", "remount,ro"], &disk.0));
    for line in [&format!("{line} --out disk/other"), "--resume disk/out --until 0.1", "report disk/out"] {
        let output = run(&folder, line);
        let said = sentence(&output, if line.starts_with("report") { 1 } else { 2 });
        assert!(said.contains("disk") && said.contains("Read-only"), "{said}");
    }
}

#[test]
#[cfg(feature = "mpi")]
fn a_killed_rank_ends_all() {
    if !crate::common::is_installed("mpiexec") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let line = BUSY.replace("--until 0.6", "--until 1000");
    let mut child = start(folder.path(), &format!("{line} --ranks 2 --out out"));
    wait("the first checkpoint", || checkpoint::latest(&out.join("checkpoint")).unwrap_or(None).is_some());
    // The younger of the two ranks: the newest process that mpiexec started in this folder.
    let ranks = || {
        let is_rank = |pid: &String| {
            let of = |file: &str| fs::read(format!("/proc/{pid}/{file}")).unwrap_or_default();
            let there = fs::read_link(format!("/proc/{pid}/cwd")).is_ok_and(|cwd| cwd == folder.path());
            there && String::from_utf8_lossy(&of("environ")).contains("OMPI_COMM_WORLD_RANK=1")
        };
        let pids = fs::read_dir("/proc")
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
        pids.filter(|name| name.parse::<u32>().is_ok()).filter(is_rank).collect::<Vec<_>>()
    };
    let rank = ranks();
    assert_eq!(rank.len(), 1, "{rank:?}");
    assert!(Command::new("kill").args(["-KILL", &rank[0]]).status().unwrap().success());
    wait("the end of the run", || child.try_wait().unwrap().is_some());
    assert!(!child.wait().unwrap().success());
    wait("the end of all ranks", || ranks().is_empty());
    assert_whole(&out);
    done(&folder, "--resume out --until 0.1 --quiet");
}
