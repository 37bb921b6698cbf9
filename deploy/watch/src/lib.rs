//! The live page: one run, a sweep, or a folder of runs, in a browser, from nothing but their files.
//!
//! The page cannot disturb a run, and a run needs no page. Files are read a piece at a time as they grow, in bounded memory
//! and time; nothing outside the folder is ever opened; nothing is written, locked or changed.
//!
//! - `root`: the folder, and the way into it; `tail`: files that grow; `table`: numbers in bounded memory;
//! - `facts`, `records`, `timeline`, `locks`: what a run's files say; `run`, `folder`, `arms`: what pages show of it;
//! - `pages`: the pages that are looked at; `server`, `hosts`, `limited`: how browsers come to them.
//!
//! The page itself is in `page/`, and is part of the program.

mod arms;
mod facts;
mod folder;
mod hosts;
mod limited;
mod locks;
mod pages;
mod records;
mod root;
mod run;
mod server;
mod table;
mod tail;
mod timeline;

use limited::Limited;
use pages::Pages;
use root::Root;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};

/// The port that is tried first where none is asked for, and how many more after it.
const FIRST_PORT: u16 = 8080;
const MORE_PORTS: u16 = 20;
/// Connections at once, at most; more wait.
const MAX_CONNECTIONS: usize = 512;
/// Threads that read files, at most.
const READERS: usize = 4;

/// A page that cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The folder.
    #[error("cannot watch {path}: {cause}; accepted: a directory, or the path of one that is to come")]
    Dir {
        /// Its path.
        path: PathBuf,
        /// Why.
        cause: io::Error,
    },
    /// The address.
    #[error(
        "cannot listen on {address}: {cause}; accepted: another --port or --bind; --port 0 takes any that is free"
    )]
    Bind {
        /// The address.
        address: SocketAddr,
        /// Why.
        cause: io::Error,
    },
    /// Serving.
    #[error("cannot serve the page")]
    Serve(#[from] io::Error),
}

/// A page that can be reached, and answers once it is served.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    root: Root,
}

impl Server {
    /// A page of the folder `dir`, which may still be missing, at `bind`. Without a `port` it is 8080, or the next one that is
    /// free.
    ///
    /// # Errors
    /// `dir` is something else, or the address cannot be had.
    pub fn bind(dir: &Path, bind: IpAddr, port: Option<u16>) -> Result<Self, WatchError> {
        let root = Root::new(dir).map_err(|cause| WatchError::Dir { path: dir.into(), cause })?;
        let listen = |port| {
            let address = SocketAddr::new(bind, port);
            TcpListener::bind(address).map_err(|cause| WatchError::Bind { address, cause })
        };
        let in_use = |error: &WatchError| match error {
            WatchError::Bind { cause, .. } => cause.kind() == io::ErrorKind::AddrInUse,
            _ => false,
        };
        let listener = match port {
            Some(port) => listen(port)?,
            None => {
                let mut found = listen(FIRST_PORT);
                for port in FIRST_PORT + 1..=FIRST_PORT + MORE_PORTS {
                    match found {
                        Err(ref error) if in_use(error) => found = listen(port),
                        _ => break,
                    }
                }
                found?
            }
        };
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address, root })
    }

    /// What to type into a browser: `http://127.0.0.1:8080/`.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Whether only this machine can reach the page.
    pub fn is_private(&self) -> bool {
        self.address.ip().is_loopback()
    }

    /// Serves until the process ends.
    ///
    /// # Errors
    /// What the system says.
    pub fn serve(self) -> Result<(), WatchError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(READERS)
            .build()?;
        let own = if self.is_private() { None } else { own_name() };
        runtime.block_on(async {
            let listener = Limited::new(tokio::net::TcpListener::from_std(self.listener)?, MAX_CONNECTIONS);
            axum::serve(listener, server::router(Pages::new(self.root), own)).await?;
            Ok(())
        })
    }

    /// Serves in a thread of its own for as long as the process lives.
    ///
    /// # Errors
    /// There is no thread to be had.
    pub fn serve_beside(self) -> Result<(), WatchError> {
        std::thread::Builder::new().name("watch".into()).spawn(move || self.serve())?;
        Ok(())
    }
}

/// The name of this machine.
fn own_name() -> Option<String> {
    rustix::system::uname().nodename().to_str().ok().map(Into::into)
}

#[cfg(test)]
mod tests;
