//! The name of every file in a run's directory. Names inside a checkpoint are the checkpoint's own.

/// The resolved configuration.
pub const CONFIG_FILE: &str = "config.toml";
/// The command that was typed.
pub const COMMAND_FILE: &str = "command.txt";
/// Version, commit, processor features and back ends.
pub const BUILD_FILE: &str = "build.json";
/// The plan that the run's processes read.
pub const PLAN_FILE: &str = "plan.bin";
/// The demonstration that the mentor-server reads.
pub const DEMONSTRATION_FILE: &str = "demonstration.csv";
/// The run's own copies of its demonstrations, where there are several.
pub const DEMONSTRATIONS_DIR: &str = "demonstrations";
/// What was found out about each mentor transition.
pub const MENTOR_FILE: &str = "mentor.csv";
/// What was counted of each incarnation of an actor, in free mode.
pub const ACTORS_FILE: &str = "actors.csv";
/// What went over the network to other hosts, in a run that has some.
pub const HOSTS_FILE: &str = "hosts.csv";
/// Greedy evaluations.
pub const EVALS_FILE: &str = "evals.csv";
/// Episodes and intervals.
pub const METRICS_FILE: &str = "metrics.jsonl";
/// Moments of the run, for its page.
pub const TIMELINE_FILE: &str = "timeline.jsonl";
/// Where the environment's states lie on a map, for pictures.
pub const MAP_FILE: &str = "map.json";
/// Logs, one file a process.
pub const LOGS_DIR: &str = "logs";
/// Checkpoints, one directory a tick.
pub const CHECKPOINTS_DIR: &str = "checkpoints";
/// Link to the newest complete checkpoint.
pub const LAST_LINK: &str = "last";
/// The weights of the best greedy evaluation.
pub const BEST_FILE: &str = "best.safetensors";
/// The outcome.
pub const RESULT_FILE: &str = "result.json";
