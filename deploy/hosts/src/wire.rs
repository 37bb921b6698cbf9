//! What carries frames: never more than that. A frame may be lost, come twice or out of order.

use crate::frame::MAX_FRAME;
use crate::limits::QUEUE;
use crate::words::{self, Told};
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// The program's first words.
const GREETING: &str = "trestle-relay 1";
/// Bytes of one of its lines that are kept.
const MAX_LINE: usize = 1000;
/// The peer of records that are the program's own news.
const NEWS: u64 = u64::MAX;
/// How long it may take to write what waits, once it is to end.
const PATIENCE: Duration = Duration::from_secs(1);

/// A wire that carries nothing any more.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WireError {
    /// The program cannot be started.
    #[error("cannot start {program}: {reason}")]
    Start {
        /// The program.
        program: String,
        /// The system's message.
        reason: String,
    },
    /// It has ended, and said why.
    #[error("{0}")]
    Ended(String),
    /// It has ended without a word: somebody has killed it.
    #[error("trestle-relay has ended")]
    Gone,
}

/// Called whenever a frame has come, by the thread that has received it.
pub type Waker = Box<dyn Fn() + Send>;

#[derive(Default)]
struct Arrived {
    frames: VecDeque<(u64, Vec<u8>)>,
    waker: Option<Waker>,
    failed: Option<WireError>,
    trouble: Option<String>,
    /// Troubles of which nobody has heard yet.
    news: VecDeque<String>,
}

/// Frames that have come, up to [`QUEUE`], for one thread that takes them and others that bring them.
#[derive(Clone, Default)]
struct Inbox(Arc<(Mutex<Arrived>, Condvar)>);

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, Arrived> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Brings a frame. Where there is no room for it, it is lost.
    fn bring(&self, peer: u64, frame: Vec<u8>) {
        let mut arrived = self.lock();
        if arrived.frames.len() < QUEUE {
            arrived.frames.push_back((peer, frame));
        }
        self.ring(&arrived);
    }

    /// Nothing will come any more.
    fn fail(&self, error: WireError) {
        let mut arrived = self.lock();
        arrived.failed.get_or_insert(error);
        self.ring(&arrived);
    }

    fn ring(&self, arrived: &Arrived) {
        self.0.1.notify_all();
        if let Some(waker) = &arrived.waker {
            waker();
        }
    }

    /// See [`Program::recv`].
    fn take(&self) -> Result<Option<(u64, Vec<u8>)>, WireError> {
        let mut arrived = self.lock();
        match (arrived.frames.pop_front(), &arrived.failed) {
            (None, Some(error)) => Err(error.clone()),
            (frame, _) => Ok(frame),
        }
    }

    /// Waits until nothing will come any more, `timeout` at the most.
    fn wait_for_the_end(&self, timeout: Duration) {
        let goes_on = |arrived: &mut Arrived| arrived.failed.is_none();
        drop(
            self.0
                .1
                .wait_timeout_while(self.lock(), timeout, goes_on)
                .unwrap_or_else(PoisonError::into_inner),
        );
    }

    /// See [`Program::wait`].
    fn wait(&self, timeout: Duration) {
        let nothing = |arrived: &mut Arrived| arrived.frames.is_empty() && arrived.failed.is_none();
        let waited = self.0.1.wait_timeout_while(self.lock(), timeout, nothing);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }

    /// See [`Program::wake_by`].
    fn wake_by(&self, waker: Waker) {
        let mut arrived = self.lock();
        arrived.waker = Some(waker);
        // Frames that have come before were not called out.
        self.ring(&arrived);
    }
}

/// The program that carries frames to peers and from them, `trestle-relay`, behind pipes. A joined host has one peer, the head, which
/// is 0. The program ends with this.
pub struct Program {
    inbox: Inbox,
    outbox: Option<SyncSender<(u64, Vec<u8>)>>,
    child: Child,
}

impl Program {
    /// Starts `command`.
    pub fn start(mut command: Command) -> Result<Self, WireError> {
        let failed = |command: &Command, reason: String| {
            let program = command.get_program().to_string_lossy().into_owned();
            WireError::Start { program, reason }
        };
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| failed(&command, error.to_string()))?;
        let (Some(mut stdin), Some(stdout), Some(stderr)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(failed(&command, "it has no pipes".into()));
        };
        let (inbox, (outbox, frames)) = (Inbox::default(), sync_channel::<(u64, Vec<u8>)>(QUEUE));
        // Its last line says why it ended.
        let troubles = inbox.clone();
        let words = thread::spawn(move || {
            let (mut last, mut told) = (String::new(), Told::default());
            for line in BufReader::new(stderr).split(b'\n').map_while(Result::ok) {
                let line = String::from_utf8_lossy(&line[..line.len().min(MAX_LINE)]);
                let Some(trouble) = words::trouble(&line.escape_debug().to_string()) else { continue };
                tracing::warn!("{}", line.escape_debug());
                let mut arrived = troubles.lock();
                arrived.trouble = Some(trouble.clone());
                match line.strip_prefix("error: ") {
                    // It is told as the reason of the end.
                    Some(error) => last = error.into(),
                    None if told.is_new(&trouble) => arrived.news.push_back(trouble),
                    None => {}
                }
            }
            last
        });
        let brings = inbox.clone();
        thread::spawn(move || {
            if let Err(error) = bring_all(stdout, &brings) {
                return brings.fail(WireError::Ended(format!("trestle-relay: {error}")));
            }
            let last = words.join().unwrap_or_default();
            brings.fail(if last.is_empty() { WireError::Gone } else { WireError::Ended(last) });
        });
        thread::spawn(move || {
            for (peer, frame) in frames {
                if write(&mut stdin, peer, &frame).is_err() {
                    return;
                }
            }
        });
        Ok(Self { inbox, outbox: Some(outbox), child })
    }

    /// Sends a frame, or loses it. Never waits.
    pub fn send(&mut self, peer: u64, frame: Vec<u8>) {
        if let Some(outbox) = &self.outbox {
            let _ = outbox.try_send((peer, frame));
        }
    }

    /// The next frame that has come, and the peer that has sent it.
    ///
    /// # Errors
    /// The program has ended.
    pub fn recv(&mut self) -> Result<Option<(u64, Vec<u8>)>, WireError> {
        self.inbox.take()
    }

    /// Waits until a frame has come, `timeout` at the most.
    pub fn wait(&mut self, timeout: Duration) {
        self.inbox.wait(timeout);
    }

    /// From now on `waker` is called whenever a frame has come.
    pub fn wake_by(&mut self, waker: Waker) {
        self.inbox.wake_by(waker);
    }

    /// The next thing that went wrong of which nobody has heard yet, in the program's words. There are
    /// [`MAX_TROUBLES`](crate::limits::MAX_TROUBLES) at the most, and each comes once.
    pub fn news(&self) -> Option<String> {
        self.inbox.lock().news.pop_front()
    }

    /// What the program has said last of something that went wrong.
    pub fn trouble(&self) -> Option<String> {
        self.inbox.lock().trouble.clone()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Its standard input ends when all that waits has been written, and so does it.
        self.outbox = None;
        self.inbox.wait_for_the_end(PATIENCE);
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Brings all records of the program until its end.
fn bring_all(mut pipe: impl Read, inbox: &Inbox) -> io::Result<()> {
    match read(&mut pipe)? {
        Some((NEWS, text)) if text == GREETING.as_bytes() => {}
        Some((_, text)) => {
            let found = String::from_utf8_lossy(&text[..text.len().min(40)]).into_owned();
            let text = format!("it says `{found}`; accepted: `{GREETING}`; build it anew");
            return Err(io::Error::new(ErrorKind::InvalidData, text));
        }
        None => return Ok(()),
    }
    while let Some((peer, frame)) = read(&mut pipe)? {
        inbox.bring(peer, frame);
    }
    Ok(())
}

/// The next record: `u32` length of what follows, `u64` peer, bytes.
fn read(pipe: &mut impl Read) -> io::Result<Option<(u64, Vec<u8>)>> {
    let mut head = [0; 12];
    match pipe.read_exact(&mut head) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let [a, b, c, d, peer @ ..] = head;
    let length = u32::from_le_bytes([a, b, c, d]) as usize;
    let bytes = length.checked_sub(8).filter(|&bytes| bytes <= MAX_FRAME);
    let bytes =
        bytes.ok_or_else(|| io::Error::new(ErrorKind::InvalidData, format!("a record of {length} bytes")))?;
    let mut frame = vec![0; bytes];
    pipe.read_exact(&mut frame)?;
    Ok(Some((u64::from_le_bytes(peer), frame)))
}

fn write(pipe: &mut impl Write, peer: u64, frame: &[u8]) -> io::Result<()> {
    let head = [&(frame.len() as u32 + 8).to_le_bytes()[..], &peer.to_le_bytes()].concat();
    pipe.write_all(&[&head, frame].concat())?;
    pipe.flush()
}
