//! `trestle demo import`

use super::report;
use crate::cli::{Ends, Header, Import};
use crate::commands::free;
use anyhow::Result;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::import::{self, Options, import};

pub(super) fn run(args: &Import) -> Result<()> {
    free(&args.out, args.overwrite)?;
    let options = Options {
        key: args.key.clone(),
        header: match args.header {
            Header::Auto => import::Header::Auto,
            Header::Yes => import::Header::Yes,
            Header::No => import::Header::No,
        },
        columns: args.columns.clone(),
        episodes: args.episodes.clone(),
        ends: match args.ends {
            Ends::Recorded => import::Ends::Recorded,
            Ends::Terminal => import::Ends::Terminal,
            Ends::CutOff => import::Ends::CutOff,
        },
    };
    let imported = import(&args.file, &options)?;
    let demonstration = &imported.demonstration;
    demo_file::write(&args.out, demonstration)?;
    outln!("{}, {}", args.file.display(), imported.format);
    for note in &imported.notes {
        outln!("note: {note}");
    }
    report(&args.out, demonstration)
}
