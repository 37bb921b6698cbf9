//! Every limit of the system in one place. A configuration that exceeds one is refused before anything starts.

use std::time::Duration;

/// Most actors a run may have.
pub const MAX_ACTORS: u32 = 64;
/// Most environment steps in one batch (`run.rollout`).
pub const MAX_ROLLOUT: u32 = 4096;
/// Most features in an observation.
pub const MAX_OBS_DIM: usize = 4096;
/// Words of the transitions in one request that gives a mentor-server its history, but for a single one that is larger: a quarter of a
/// megabyte.
pub const HISTORY_WORDS: usize = 1 << 16;
/// Most discrete actions.
pub const MAX_ACTIONS: usize = 1024;
/// Most layers' sizes in a network, input and output included.
pub const MAX_SIZES: usize = 8;
/// Most units in one layer.
pub const MAX_WIDTH: usize = 4096;
/// Most threads that share a gradient step: above the processors of any machine on which a network could use them.
pub const MAX_THREADS: usize = 64;
/// Most rows and columns of a convolution's kernel, and of its stride.
pub const MAX_KERNEL: usize = 64;
/// Most transitions in the replay.
pub const MAX_REPLAY: usize = 100_000_000;
/// Most steps that a target looks ahead (`learner.n_step`).
pub const MAX_N_STEP: usize = 64;
/// Most steps between a state and the later one that a learned bridge takes for its goal (`mentor.learned.horizon`).
pub const MAX_HORIZON: usize = 64;
/// Most relabelled transitions for each stored one in D-Shape (`rival.dshape.goals`).
pub const MAX_RELABELLED: usize = 16;
/// Most paths of its own that an observer keeps (`mentor.learned.own_paths`).
pub const MAX_OWN_PATHS: usize = 64;
/// Most places of one of them; a longer one is not kept.
pub const MAX_OWN_PLACES: usize = 4096;
/// Most numbers of the places of all of them: half a megabyte in each message.
pub const MAX_OWN_NUMBERS: usize = 1 << 17;
/// Most words of all options together, if each mentor transition had a bridge of `mentor.k` steps (`exploration.guide_whole`):
/// sixteen megabytes in a message.
pub const MAX_OPTION_WORDS: usize = 1 << 22;
/// Most transitions in a demonstration.
pub const MAX_MENTOR_TRANSITIONS: usize = 10_000_000;
/// Most demonstrations that a run learns from.
pub const MAX_MENTORS: usize = 64;
/// Most annotations or mentor transitions in one answer of the mentor-server.
pub const MAX_QUERY_ROWS: u32 = 4096;
/// Most `mentor/query` clients at once.
pub const MAX_QUERY_CLIENTS: usize = 8;
/// Most stored transitions that `bridge` search follows (`mentor.k`), and most mentor states ahead (`mentor.n`).
pub const MAX_BRIDGE_DEPTH: u32 = 64;
/// Largest reply of an actor (a snapshot of its environment, or its evaluations), bytes.
pub const MAX_REPLY_BYTES: usize = 16 << 20;
/// Largest side of a maze, cells.
pub const MAX_MAP_SIDE: usize = 1000;
/// Largest configuration or map file, bytes.
pub const MAX_TEXT_BYTES: u64 = 16 << 20;
/// Size at which a process's log is put aside and a new one begun, bytes. One that was put aside before goes.
pub const MAX_LOG_BYTES: u64 = 4 << 20;

/// Batches that may wait for the learner, each actor.
pub const TRANSITIONS_BUFFER: usize = 64;
/// Replies that may wait for the learner, each actor.
pub const REPLIES_BUFFER: usize = 8;

/// How long a process waits at its start for the others to answer its hello. An environment may take minutes to be imported;
/// a process that dies or hangs meanwhile is its supervisor's concern.
pub const ASSEMBLY: Duration = Duration::from_secs(1800);
/// How long a message may wait for a receiver that is known to be there.
pub const HANDSHAKE: Duration = Duration::from_secs(30);
/// How often an unanswered hello is repeated.
pub const HELLO_INTERVAL: Duration = Duration::from_millis(50);
/// How long a full buffer may block a sender before the send fails.
pub const BACKPRESSURE: Duration = Duration::from_secs(10);
/// Longest sleep of a waiting process before it looks at its shutdown flag again.
pub const WAIT_SLICE: Duration = Duration::from_millis(200);
/// How long the supervisor waits for the other processes once the learner has left.
pub const GRACE: Duration = Duration::from_secs(5);
/// Least time between the first SIGINT and a later one that means "stop at once".
pub const REPEAT: Duration = Duration::from_millis(500);
/// How long a start waits for the end of the processes of a dead run that still have the lock of its directory.
pub const FENCE_WAIT: Duration = Duration::from_secs(10);
/// How often a process of a run gives a sign of life, and how often the supervisor looks for it.
pub const BEAT: Duration = Duration::from_secs(1);
/// Least seconds without a sign of life after which a process may count as dead: several beats.
pub const MIN_DEADLINE_S: u32 = 3;
/// Most such seconds.
pub const MAX_DEADLINE_S: u32 = 86_400;
/// How long the supervisor waits for the end of a process when another one says that it has lost it.
pub const BLAME: Duration = Duration::from_secs(1);
/// Pause before the second restart of a run that does not get ahead; it doubles with each further one.
pub const RESTART_BACKOFF: Duration = Duration::from_millis(250);
/// Longest such pause.
pub const RESTART_BACKOFF_MOST: Duration = Duration::from_secs(8);
/// Time after which a restart no longer counts.
pub const RESTART_WINDOW: Duration = Duration::from_secs(600);
/// Most restarts without getting ahead that may be allowed (`supervise.restarts`).
pub const MAX_RESTARTS: u32 = 1000;
/// How long the learner waits for the mentor-server to take in one batch.
pub const OBSERVE_DEADLINE: Duration = Duration::from_secs(30);
/// How often the supervisor frees the places of clients of the mentor-server that have died.
pub const REAP: Duration = Duration::from_secs(10);
/// How long a client waits for an answer to a query.
pub const QUERY_DEADLINE: Duration = Duration::from_secs(10);
/// Time that a process which has been started is given to make its place among the services before anything that looks dead is
/// removed there.
pub const SETTLE: Duration = Duration::from_secs(1);
