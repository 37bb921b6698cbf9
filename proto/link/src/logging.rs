//! Log lines: `<time> <level> run=<run> role=<role> tick=<tick> <target>: <message> <fields>`, on standard error,
//! filtered by `RUST_LOG`.

use std::fmt;
use std::io::IsTerminal;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{FormatEvent, FormatFields, Writer};
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::registry::LookupSpan;
use trestle_proto::round::Round;

/// The target of iceoryx2's lines.
pub const IPC: &str = "iceoryx2_bb_loggers";

static TICK: AtomicU64 = AtomicU64::new(0);
static WHO: OnceLock<Who> = OnceLock::new();

/// Whose lines these are.
#[derive(Debug)]
struct Who {
    run: u64,
    role: String,
}

/// Says at which tick this process is; every later line carries it.
pub fn set_tick(tick: Round) {
    TICK.store(tick.into(), Ordering::Relaxed);
}

/// Starts logging for this process, at `level` unless `RUST_LOG` says otherwise: `info` where a file takes the lines,
/// `warn` where they would come between what a person reads. `run` is 0 where there is no run. A second call changes
/// nothing.
pub fn init(run: u64, role: &str, level: &str) {
    if WHO.set(Who { run, role: role.into() }).is_err() {
        return;
    }
    // iceoryx2 filters by itself before it hands a line on; what it reports below a warning is about its own insides.
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Warn);
    // Where a process was killed, its memory is there no more when its peers come to remove it: that needs no line among those that
    // a person reads.
    let quiet = if level == "warn" { format!("{level},{IPC}=error") } else { level.into() };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(quiet));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // A line that cannot be written is lost; to report that in the same place would end the process.
        .log_internal_errors(false)
        .event_format(Line)
        .finish();
    // Failing means that this process has a subscriber already: a test's.
    let _ = tracing::subscriber::set_global_default(subscriber);
}

struct Line;

impl<S, N> FormatEvent<S, N> for Line
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        SystemTime.format_time(&mut writer)?;
        let (level, target) = (event.metadata().level(), event.metadata().target());
        write!(writer, " {level:>5}")?;
        if let Some(who) = WHO.get() {
            write!(writer, " run={:08x} role={} tick={}", who.run, who.role, TICK.load(Ordering::Relaxed))?;
        }
        write!(writer, " {target}: ")?;
        context.field_format().format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}
