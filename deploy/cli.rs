//! Arguments as they are typed. What they mean together is resolved by the commands.

use crate::carrier::{Network, Remote};
use crate::flags::{Limits, Target, address, help, presets, setting, whole, word, word_or};
use crate::submit::options::Options;
use crate::sweep::arms::Arm;
use crate::sweep::jobs::MAX_JOBS;
use crate::sweep::over::Over;
use crate::sweep::seeds::Seeds;
use crate::sweep::share::Share;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::net::IpAddr;
use std::path::PathBuf;
use std::str::FromStr;
use trestle_hosts::limits::MAX_SILENCE_S;
use trestle_mentor_server::import::{Columns, Episodes};
use trestle_proto::config::{Algo, Config as Settings, Mode};
use trestle_proto::incarnation::Incarnation;
use trestle_proto::limits::MAX_ACTORS;
use trestle_proto::names;
use trestle_suite::mentor::Mentor;
use trestle_suite::set::MAX_TRAJECTORIES;

/// Greedy episodes that a command plays, at most.
const MAX_EPISODES: u64 = 4096;
/// The highest port.
const MAX_PORT: u64 = u16::MAX as u64;

/// Deep implicit imitation Q-learning for agents whose actions differ from their mentor's.
#[derive(Debug, Parser)]
#[command(name = "trestle", version, max_term_width = 110)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train one agent
    Train(Train),
    /// Go on where a run stopped, or prolong one that is finished
    Resume(Resume),
    /// Train many agents: algorithms x seeds x settings
    Sweep(Sweep),
    /// Tables, plots and a page from any set of runs
    Report(Report),
    /// Show a run, a sweep or a folder of runs in a browser, live
    Watch(Watch),
    /// Send runs to Weights & Biases, Trackio or MLflow, live or afterwards (needs the Python package)
    Sync(Sync),
    /// Play the greedy policy of a run's checkpoint and draw its path
    Eval(Eval),
    /// Write a run's network for other programs
    Export(Export),
    /// Work with demonstrations
    #[command(subcommand)]
    Demo(Demo),
    /// Work with maps
    #[command(subcommand)]
    Map(Map),
    /// Show or check a configuration
    #[command(subcommand)]
    Config(Config),
    /// Look at what runs need from this machine, and at what dead runs have left
    Doctor(Doctor),
    /// Lend this machine's processors to a run that another machine trains
    Join(Join),
    /// Work with what hosts of one run need
    #[command(subcommand)]
    Hosts(HostsCommand),
    /// One actor process of a run (started by `train`)
    Actor(ActorRole),
    /// The learner process of a run (started by `train`)
    Learner(Role),
    /// The mentor-server process of a run (started by `train`)
    MentorServer(Role),
    /// The process of a run that speaks to other hosts (started by `train` and `join`)
    #[command(subcommand)]
    Relay(RelayRole),
    /// Remove what a run without a supervisor has shared
    #[command(hide = true)]
    Orphaned {
        /// The run's identity
        run: u64,
    },
}

/// Where a configuration comes from.
#[derive(Debug, Args)]
pub(crate) struct Source {
    /// A preset, a TOML file, or an environment of Gymnasium's, such as gym:CartPole-v1
    #[arg(value_name = "PRESET|CONFIG.TOML|gym:ID")]
    pub(crate) config: String,
    /// Override one setting by its dotted key; may be repeated, the last one wins
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,
}

#[derive(Debug, Args)]
#[command(after_help = presets())]
pub(crate) struct Train {
    #[command(flatten)]
    pub(crate) typed: Typed,
    /// The run's directory; runs/CONFIG-ALGO-seedN if not given
    #[arg(long, value_name = "DIR", value_parser = Target)]
    pub(crate) out: Option<PathBuf>,
    /// Go on from the newest complete checkpoint in the directory
    #[arg(long, conflicts_with = "overwrite")]
    pub(crate) resume: bool,
    /// Replace the directory if it holds a run
    #[arg(long)]
    pub(crate) overwrite: bool,
    #[command(flatten)]
    pub(crate) remote: Remote,
    #[command(flatten)]
    pub(crate) beside: Beside,
    /// Print the result only
    #[arg(long)]
    pub(crate) quiet: bool,
}

impl Train {
    /// As [`Typed::apply`], where the number that is typed counts this host's actors.
    pub(crate) fn apply(&self, config: &mut Settings) {
        self.typed.apply(config);
        if let Some(here) = self.typed.actors {
            config.run.actors = here.saturating_add(self.remote.remote_actors.unwrap_or(0));
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct Join {
    /// Where the run listens, such as tls/head:7447
    #[arg(value_name = "URL")]
    pub(crate) url: String,
    /// Actors to run here, at the most
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1..=u64::from(MAX_ACTORS)))]
    pub(crate) actors: u32,
    /// The name by which the run knows this host; its own name if not given
    #[arg(long, value_name = "NAME")]
    pub(crate) name: Option<String>,
    #[command(flatten)]
    pub(crate) network: Network,
    /// Seconds to wait for a run that does not answer
    #[arg(long, value_name = "SECONDS", default_value_t = 1800, value_parser = whole::<u32>(1..=u64::from(MAX_SILENCE_S)))]
    pub(crate) wait: u32,
    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum HostsCommand {
    /// Make certificates for a run over several hosts
    Credentials {
        /// The directory to write head.pem and join.pem into
        #[arg(long, value_name = "DIR", value_parser = Target)]
        out: PathBuf,
        /// A name or an address by which other hosts reach the one that trains; may be repeated. If none is given: this
        /// host's name and address, localhost and 127.0.0.1
        #[arg(long = "name", value_name = "HOST")]
        names: Vec<String>,
    },
}

#[derive(Debug, Subcommand)]
pub(crate) enum RelayRole {
    /// On the host of the learner
    Head {
        #[command(flatten)]
        role: Role,
        /// The first of the actors that are on other hosts
        #[arg(long, value_name = "ACTOR")]
        first: u32,
        /// Where other hosts reach this one
        #[arg(long, value_name = "URL")]
        listen: String,
        #[command(flatten)]
        network: Network,
        /// How often it has been replaced
        #[arg(long, value_name = "N", default_value_t = 0)]
        replacements: u16,
    },
    /// On a host that has joined
    Joined {
        #[command(flatten)]
        role: Role,
        /// Where the run listens
        #[arg(long, value_name = "URL")]
        url: String,
        /// The run's identity on this host
        #[arg(long, value_name = "N")]
        identity: u64,
        /// Actors that this host offers
        #[arg(long, value_name = "N")]
        actors: u32,
        /// The name of this host
        #[arg(long, value_name = "NAME")]
        name: String,
        #[command(flatten)]
        network: Network,
        /// Seconds to wait for an answer
        #[arg(long, value_name = "SECONDS")]
        wait: u32,
    },
}

/// A run has its configuration with it, so it need not be typed again.
#[derive(Debug, Args)]
pub(crate) struct Resume {
    /// A run's directory, or one of the run's own files
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// Override one of the settings that may change: run.stop_when_solved, learner.threads, checkpoint.keep, [env.hazard] and
    /// `[supervise]`; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,
    #[command(flatten)]
    pub(crate) remote: Remote,
    #[command(flatten)]
    pub(crate) beside: Beside,
    /// Print the result only
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// The page beside what is trained.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct Beside {
    /// Show it in a browser meanwhile, on this machine alone; at 8080 or the next free port if none is given
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, value_parser = whole::<u16>(0..=MAX_PORT))]
    pub(crate) watch: Option<Option<u16>>,
}

#[derive(Debug, Args)]
pub(crate) struct Watch {
    /// A run, a sweep, or any directory with runs in it; it may be one that is to come
    #[arg(value_name = "DIR", default_value = "runs")]
    pub(crate) dir: PathBuf,
    /// The port; 8080 or the next one that is free if not given, any free one if 0
    #[arg(long, value_name = "N", value_parser = whole::<u16>(0..=MAX_PORT))]
    pub(crate) port: Option<u16>,
    /// The address; with 0.0.0.0 everybody who can reach this machine sees the page
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1", value_parser = address)]
    pub(crate) bind: IpAddr,
}

#[derive(Debug, Args)]
pub(crate) struct Sync {
    /// A run, a sweep, or any directory with runs in it
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,
    /// The tracker
    #[arg(long, value_enum, value_name = "TRACKER")]
    pub(crate) to: Tracker,
    /// The tracker's project, or experiment; `trestle` if not given
    #[arg(long, value_name = "NAME", default_value = "trestle")]
    pub(crate) project: String,
    /// Send what there is and end, also where runs are still being trained
    #[arg(long)]
    pub(crate) once: bool,
    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// Who keeps records of experiments.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Tracker {
    /// Weights & Biases
    Wandb,
    /// Trackio, of Hugging Face
    Trackio,
    /// MLflow
    Mlflow,
}

impl Tracker {
    /// Its word on the command line, and that of the package's extra.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Wandb => "wandb",
            Self::Trackio => "trackio",
            Self::Mlflow => "mlflow",
        }
    }
}

#[derive(Debug, Args)]
#[command(after_help = presets())]
pub(crate) struct Sweep {
    /// A preset, a TOML file, or `suite` for the tasks of a set; not needed with --resume
    #[arg(value_name = "PRESET|CONFIG.TOML|suite", required_unless_present = "resume")]
    pub(crate) config: Option<String>,
    /// With `suite`: the set of tasks, choosing, reporting, or a TOML file
    #[arg(long, value_name = "SET|FILE", requires = "config")]
    pub(crate) task_set: Option<String>,
    /// With `suite`: only tasks whose names have this form, such as mazes-one-hot/* or */rooms-*; may be repeated
    #[arg(long, value_name = "PATTERN", requires = "task_set")]
    pub(crate) tasks: Vec<String>,
    /// Override one setting by its dotted key; may be repeated, the last one wins. With --resume alone: a setting that may change,
    /// which `trestle resume --help` names
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,
    /// Algorithms, and rivals such as dqn+gaifo, each an arm of its own; with no --arm either: that of the configuration
    #[arg(long, value_name = "ALGO,...", value_delimiter = ',', value_parser = Arm::of_name, requires = "config")]
    pub(crate) algos: Vec<Arm>,
    /// A further arm with settings of its own; may be repeated
    #[arg(long = "arm", value_name = "NAME:KEY=VALUE,...", requires = "config")]
    pub(crate) arms: Vec<Arm>,
    /// Train every arm with each of these values, as in env.map=random:1:20x20,random:2:20x20; may be repeated
    #[arg(long, value_name = "KEY=VALUE,...", requires = "config")]
    pub(crate) over: Vec<Over>,
    /// Seeds: 0..30 is thirty of them, 1,5,7 three; those of the sweep with --resume alone
    #[arg(long, value_name = "SEEDS", required_unless_present = "resume")]
    pub(crate) seeds: Option<Seeds>,
    /// Runs at once; as many as cores and memory allow, or with --submit as the cluster allows, if not given
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=MAX_JOBS as u64))]
    pub(crate) jobs: Option<u16>,
    #[command(flatten)]
    pub(crate) limits: Limits,
    /// The sweep's directory
    #[arg(long, value_name = "DIR", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// Keep the runs that are complete and go on with the others; with a higher --episodes or --env-steps prolong them all
    #[arg(long)]
    pub(crate) resume: bool,
    /// Train only every OF-th run, from number PART on: a task's share, beside others in the same directory
    #[arg(long, value_name = "PART/OF", requires = "resume")]
    pub(crate) share: Option<Share>,
    /// Hand the runs to a scheduler instead of training them here
    #[arg(long, value_enum, value_name = "SCHEDULER", conflicts_with_all = ["share", "watch"])]
    pub(crate) submit: Option<Scheduler>,
    /// With `--submit slurm`: options of sbatch, such as partition=x,time=4:00:00,cpus=4; may be repeated
    #[arg(long, value_name = "KEY=VALUE,...", requires = "submit")]
    pub(crate) slurm: Vec<Options>,
    /// With `--submit kubernetes`: image, claim, namespace, name, cpus, memory and shm; may be repeated
    #[arg(long, value_name = "KEY=VALUE,...", requires = "submit")]
    pub(crate) kubernetes: Vec<Options>,
    /// With --submit: print the job, and neither write nor start anything
    #[arg(long, requires = "submit")]
    pub(crate) dry_run: bool,
    #[command(flatten)]
    pub(crate) beside: Beside,
    /// Print the summary only
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// Schedulers of clusters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Scheduler {
    /// An array job
    Slurm,
    /// An Indexed Job
    Kubernetes,
}

#[derive(Debug, Args)]
pub(crate) struct Report {
    /// A sweep, a run, or any directory with runs in it
    #[arg(value_name = "DIR")]
    pub(crate) runs: PathBuf,
    /// Where the report goes; DIR/report if not given
    #[arg(long, value_name = "DIR", value_parser = Target)]
    pub(crate) out: Option<PathBuf>,
    /// Leave headings and notes out of the files of pictures, as for a paper that has its own
    #[arg(long)]
    pub(crate) no_titles: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Eval {
    /// A run's directory, or one of the run's own files
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Greedy episodes
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = whole::<u32>(1..=MAX_EPISODES))]
    pub(crate) episodes: u32,
    /// The checkpoint, by its tick; `last` is the newest complete one, `best` that of the best greedy evaluation
    #[arg(long, value_name = "last|best|TICK", default_value = "last")]
    pub(crate) checkpoint: Which,
    /// Seed of the episodes' random streams; the run's own if not given
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = setting::<u64>("run.seed"))]
    pub(crate) seed: Option<u64>,
    /// Draw the first episode into a file: .gif in motion, .png, .svg or .pdf still; on its map, or as the environment renders
    /// itself (no .pdf)
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) picture: Option<PathBuf>,
    /// Replace the picture if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
    /// Print one JSON object instead, and draw nothing on the terminal
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Export {
    /// A run's directory, or one of the run's own files
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// The form of the file
    #[arg(long, value_enum)]
    pub(crate) format: Format,
    /// The file to write
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// The checkpoint, by its tick; `last` is the newest complete one
    #[arg(long, value_name = "last|best|TICK", default_value = "last")]
    pub(crate) checkpoint: Which,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Format {
    /// A model for onnxruntime and others, the encoding of its input included
    Onnx,
    /// Tensors with names
    Safetensors,
}

/// One of a run's checkpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// The newest complete one.
    Last,
    /// The weights of the best greedy evaluation.
    Best,
    /// That of this tick.
    Tick(u64),
}

impl FromStr for Which {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "last" => Ok(Self::Last),
            "best" => Ok(Self::Best),
            _ => text.parse().map(Self::Tick).map_err(|_| {
                format!(
                    "accepted: last, best, or the tick of a checkpoint{}",
                    names::hint(text, ["last", "best"])
                )
            }),
        }
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Demo {
    /// Plan an optimal path of the mentor, or what another mentor does, and write its states as CSV
    Plan(Plan),
    /// Record greedy episodes of a run's newest checkpoint: their states, never their actions
    Record(Record),
    /// Take the states from a file or data set of others: HDF5 (Minari, D4RL, robomimic and others), Arrow, CSV, NPY, NPZ
    Import(Import),
    /// Describe a demonstration and how it meets a configuration's thresholds
    Inspect(Inspect),
}

#[derive(Debug, Args)]
pub(crate) struct Plan {
    #[command(flatten)]
    pub(crate) source: Source,
    /// What the mentor does; all but the first four are bad ones
    #[arg(long, default_value = "planned", value_parser = word::<Mentor>())]
    pub(crate) mentor: Mentor,
    /// Decides what the mentor leaves to chance
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u64>(0..=i64::MAX as u64))]
    pub(crate) mentor_seed: u64,
    /// Trajectories; more than one with the mentor `planned` where states are no cells of a map
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u32>(1..=u64::from(MAX_TRAJECTORIES)))]
    pub(crate) trajectories: u32,
    /// The file to write
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Inspect {
    /// A CSV file of states, or a run's directory
    #[arg(value_name = "FILE|RUN")]
    pub(crate) demo: PathBuf,
    /// The configuration whose metric, thresholds and map apply (a run's own, or none, if not given)
    #[arg(long, value_name = "PRESET|CONFIG.TOML")]
    pub(crate) config: Option<String>,
    /// Override one setting of it; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,
    /// The two features that are drawn, by their places: `0,1`
    #[arg(long, value_name = "X,Y", value_parser = pair)]
    pub(crate) axes: Option<[usize; 2]>,
    /// Draw the trajectories into this file as well: .svg, .png or .pdf
    #[arg(long, alias = "svg", value_name = "FILE", value_parser = Target)]
    pub(crate) picture: Option<PathBuf>,
    /// Replace the picture if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

/// Two whole numbers: `X,Y`.
fn pair(text: &str) -> Result<[usize; 2], String> {
    let parsed =
        text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    parsed.ok_or_else(|| "accepted: two whole numbers, such as 0,1".into())
}

#[derive(Debug, Args)]
pub(crate) struct Record {
    /// A run's directory, or one of the run's own files
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Greedy episodes to play; those that repeat an earlier one are recorded once
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = whole::<u32>(1..=MAX_EPISODES))]
    pub(crate) episodes: u32,
    /// The file to write
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// Record episodes that do not succeed as well
    #[arg(long)]
    pub(crate) all: bool,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Import {
    /// A file, or the folder of a Minari data set; the format is detected from the contents
    #[arg(value_name = "FILE|FOLDER")]
    pub(crate) file: PathBuf,
    /// The file to write
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// Part of the observations where they are a dictionary, such as `observation` or `robot/position`, or a path in the file,
    /// such as `data/demo_*/obs/joint_pos`, where * stands for the episodes
    #[arg(long, value_name = "KEY")]
    pub(crate) key: Option<String>,
    /// Whether the first row of a table names its columns
    #[arg(long, value_enum, default_value_t = Header::Auto)]
    pub(crate) header: Header,
    /// Features to take, in this order: `0..4`, `0,1,4..6`, or names of CSV columns; all if not given
    #[arg(long, value_name = "COLUMNS")]
    pub(crate) columns: Option<Columns>,
    /// Episodes to take, from 0: `0..3` are the first three, `0..3,5` one more; all if not given
    #[arg(long, value_name = "FROM..TO,...")]
    pub(crate) episodes: Option<Episodes>,
    /// Which trajectories end in a terminal state, one without a value
    #[arg(long, value_enum, default_value_t = Ends::Recorded)]
    pub(crate) ends: Ends,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Ends {
    /// Those that the source says were terminated
    Recorded,
    /// All
    Terminal,
    /// None
    CutOff,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Header {
    /// If it looks like that
    Auto,
    /// It does
    Yes,
    /// It is data
    No,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Map {
    /// Make a map of one in another form: 0 and 1, D4RL's strings, nested lists, gym-maze's NPY, drawings of +---+
    Import(MapImport),
}

#[derive(Debug, Args)]
pub(crate) struct MapImport {
    /// A text or NPY file; the format is detected from the contents
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// The file to write
    #[arg(long, value_name = "FILE", value_parser = Target)]
    pub(crate) out: PathBuf,
    /// The start as a cell of the source, from 0,0 at the top left
    #[arg(long, value_name = "COLUMN,ROW", value_parser = pair)]
    pub(crate) start: Option<[usize; 2]>,
    /// The goal, likewise
    #[arg(long, value_name = "COLUMN,ROW", value_parser = pair)]
    pub(crate) goal: Option<[usize; 2]>,
    /// Which of 0 and 1 is a wall
    #[arg(long, value_name = "0|1", default_value_t = 1, value_parser = whole::<u8>(0..=1))]
    pub(crate) walls: u8,
    /// Replace the file if it exists
    #[arg(long)]
    pub(crate) overwrite: bool,
}

/// A configuration with the flags of `train` that stand for settings.
#[derive(Debug, Args)]
pub(crate) struct Typed {
    #[command(flatten)]
    pub(crate) source: Source,
    #[arg(long, value_parser = word_or::<Algo>(Arm::instead), help = help("run.algo"))]
    pub(crate) algo: Option<Algo>,
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = setting::<u64>("run.seed"), help = help("run.seed"))]
    pub(crate) seed: Option<u64>,
    #[command(flatten)]
    pub(crate) limits: Limits,
    #[arg(long, value_parser = word::<Mode>(), help = help("run.mode"))]
    pub(crate) mode: Option<Mode>,
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = setting::<u32>("run.actors"), help = help("run.actors"))]
    pub(crate) actors: Option<u32>,
}

impl Typed {
    /// The texts of `--set`, and `--algo` after them: an algorithm brings along defaults of its own.
    pub(crate) fn sets(&self) -> Vec<String> {
        let algo = self.algo.map(|algo| format!("run.algo={:?}", algo.name()));
        self.source.sets.iter().cloned().chain(algo).collect()
    }

    /// Sets the settings of the other flags.
    pub(crate) fn apply(&self, config: &mut Settings) {
        let run = &mut config.run;
        run.seed = self.seed.unwrap_or(run.seed);
        run.mode = self.mode.unwrap_or(run.mode);
        run.actors = self.actors.unwrap_or(run.actors);
        self.limits.apply(config);
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Config {
    /// Print every setting of a configuration
    Show(Typed),
    /// Say whether a run could start with a configuration
    Check(Typed),
    /// Print settings with type, default, what is accepted, and what they are for
    List {
        /// A setting or a table, such as run.actors or learner, or a preset for the settings that it changes; everything if not given
        #[arg(value_name = "KEY|PRESET")]
        key: Option<String>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct Doctor {
    /// Remove what dead runs have left
    #[arg(long)]
    pub(crate) fix: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Role {
    /// The run's directory, prepared by `trestle train`
    #[arg(long, value_name = "DIR")]
    pub(crate) run: PathBuf,
    /// Leave when standard input is closed; give signs of life there if it is a socket
    #[arg(long)]
    pub(crate) watch_stdin: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ActorRole {
    #[command(flatten)]
    pub(crate) role: Role,
    /// Index of the actor, from 0
    #[arg(long, value_parser = whole::<u32>(0..=u64::from(MAX_ACTORS - 1)))]
    pub(crate) index: u32,
    /// How often it has been replaced; run.mode = free
    #[arg(long, value_name = "N", default_value_t)]
    pub(crate) incarnation: Incarnation,
}
