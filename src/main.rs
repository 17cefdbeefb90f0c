//! The program: parse, run, report.

use std::io::{Write, stderr};
use std::process::ExitCode;

use log::{Level, Log, Metadata, Record};
use sphpetsc::cli::{self, Command};
use sphpetsc::parallel::{self, Ranks};
use sphpetsc::{Error, Result, lab, page, run, study};

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(report_panic));
    let running = parallel::start();
    let ranks = running.ranks();
    let outcome = std::panic::catch_unwind(|| execute(ranks));
    // Launchers end the others once a rank fails: the first one speaks, and fails, for all.
    match outcome {
        Ok(Err(error)) if ranks.is_first() => {
            error.to_string().lines().for_each(say);
            error.exit_code()
        }
        Ok(_) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}

fn execute(ranks: Ranks) -> Result<()> {
    match cli::parse(std::env::args_os())? {
        Command::Text(_) | Command::Cases | Command::ShowCase(_) | Command::Check(_) if !ranks.is_first() => {
            Ok(())
        }
        Command::Check(_) | Command::Study(_) | Command::Solvers(_) if ranks.are_several() => {
            Err(Error::Input("only a run takes several ranks: leave mpiexec out".into()))
        }
        Command::Text(text) => cli::print(&text),
        Command::Cases => cli::print(&cli::case_list()),
        Command::ShowCase(name) => cli::print(cli::case_text(&name)?),
        Command::Check(args) => {
            start_log(args.common.log_level());
            run::check(&args, &args.load_case()?)
        }
        Command::Run(args) => {
            let case = args.load_case()?;
            if let Some(count) = args.ranks {
                parallel::launch(count, args.common.threads.unwrap_or(1))?;
            }
            start_log(if ranks.is_first() { args.common.log_level() } else { log::LevelFilter::Off });
            run::run(&args, &case, ranks)
        }
        Command::Report(args) => page::write(&args),
        Command::Solvers(args) if args.list => cli::print(lab::CATALOGUE),
        Command::Solvers(args) => {
            start_log(args.common.log_level());
            lab::solvers(&args)
        }
        Command::Trial(args) => lab::try_set(&args),
        Command::Study(args) if args.list => cli::print(&study::list()),
        Command::Study(args) => {
            start_log(args.common.log_level());
            study::study(&args)
        }
    }
}

/// One sentence on standard error; where nobody listens there is nobody to tell.
fn say(sentence: &str) {
    let _ = writeln!(stderr(), "error: {sentence}");
}

/// A panic is a defect of this program, and said as such.
fn report_panic(panic: &std::panic::PanicHookInfo) {
    let version = env!("CARGO_PKG_VERSION");
    let what = panic.to_string().replace('\n', " ");
    say(&format!(
        "sphpetsc {version} has a defect: it {what}: please report this with the case file and command line"
    ));
    parallel::abort();
}

/// Prints what this program logs; other crates' messages are not for the user.
struct Stderr;

impl Log for Stderr {
    fn enabled(&self, metadata: &Metadata) -> bool {
        metadata.target().starts_with("sphpetsc")
    }

    fn log(&self, record: &Record) {
        if self.enabled(record.metadata()) {
            let prefix = match record.level() {
                Level::Error => "error: ",
                Level::Warn => "warning: ",
                _ => "",
            };
            let _ = writeln!(stderr(), "{prefix}{}", record.args());
        }
    }

    fn flush(&self) {}
}

fn start_log(level: log::LevelFilter) {
    // Fails only if a logger is set already, which serves as well.
    let _ = log::set_logger(&Stderr);
    log::set_max_level(level);
}
