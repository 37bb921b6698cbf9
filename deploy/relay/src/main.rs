//! The program `trestle-relay`: it carries records between a pipe and the hosts of a run, by Zenoh.
//!
//! `trestle relay` starts it and does all else: it counts, resends and drops records that came twice. So a record may be lost, come twice
//! or out of order here, and nothing in a record matters to this program.
//!
//! - [`pipe`]: records on standard input and output;
//! - [`net`]: the Zenoh session of the host that listens, or of a host that joins;
//! - [`url`]: the addresses that may be listened at and connected to;
//! - [`credentials`]: certificates and their files.

mod credentials;
mod net;
mod pipe;
mod url;

use std::process::ExitCode;

/// A failure, in words.
type Failure = Box<dyn std::error::Error + Send + Sync>;

const USAGE: &str = "usage:
  trestle-relay check URL [--credentials FILE] [--insecure]
  trestle-relay listen URL [--credentials FILE] [--insecure]
  trestle-relay connect URL ID [--credentials FILE] [--insecure]
  trestle-relay credentials DIR NAME...
  trestle-relay version";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match run(&args) {
        Ok(status) => status,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Options that stand behind the others.
#[derive(Debug, Default)]
struct Options {
    credentials: Option<String>,
    insecure: bool,
}

impl Options {
    fn read(args: &[String]) -> Option<Self> {
        let mut options = Self::default();
        let mut args = args.iter();
        while let Some(arg) = args.next() {
            match arg.as_str() {
                "--insecure" => options.insecure = true,
                "--credentials" => options.credentials = Some(args.next()?.clone()),
                _ => return None,
            }
        }
        Some(options)
    }
}

fn run(args: &[String]) -> Result<ExitCode, Failure> {
    let words: Vec<&str> = args.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["version"] => println!("{}", pipe::GREETING),
        ["credentials", dir, names @ ..] if !names.is_empty() => credentials::make(dir.as_ref(), names)?,
        ["check", at, ..] => {
            let Some(options) = Options::read(&args[2..]) else { return Ok(misused()) };
            net::config(&url::checked(at, options.insecure)?, options.credentials.as_deref())?;
        }
        ["listen", at, ..] => {
            let Some(options) = Options::read(&args[2..]) else { return Ok(misused()) };
            net::listen(&url::checked(at, options.insecure)?, options.credentials.as_deref())?;
        }
        ["connect", to, id, ..] => {
            let Some(options) = Options::read(&args[3..]) else { return Ok(misused()) };
            let id = u64::from_str_radix(id, 16)
                .map_err(|_| format!("{id}; accepted: 1 to 16 hexadecimal digits"))?;
            net::connect(&url::checked(to, options.insecure)?, id, options.credentials.as_deref())?;
        }
        _ => return Ok(misused()),
    }
    Ok(ExitCode::SUCCESS)
}

fn misused() -> ExitCode {
    eprintln!("{USAGE}");
    ExitCode::from(2)
}
