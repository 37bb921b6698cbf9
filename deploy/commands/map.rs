//! `trestle map`

use super::free;
use crate::cli::{Map, MapImport};
use crate::status::ExitCode;
use anyhow::{Context, Result};
use std::io::{Read, Write};
use trestle_actor::env::grid::foreign::{Choices, of_numbers, of_text};
use trestle_actor::env::grid::{ActionSet, REGULAR, mentor_path};
use trestle_mentor_server::import;
use trestle_proto::limits::{MAX_MAP_SIDE, MAX_TEXT_BYTES};
use trestle_proto::regular_file;
use trestle_proto::rundir::{Durable, write_atomically};

pub(super) fn run(args: &Map) -> Result<ExitCode> {
    match args {
        Map::Import(args) => import(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn import(args: &MapImport) -> Result<()> {
    free(&args.out, args.overwrite)?;
    let origin = args.file.display().to_string();
    let choices = Choices { start: args.start, goal: args.goal, zero_is_wall: args.walls == 0 };
    let mut start = Vec::new();
    regular_file::open(&args.file, MAX_TEXT_BYTES)?.take(6).read_to_end(&mut start)?;
    let imported = if start == b"\x93NUMPY" {
        of_numbers(&origin, &import::grid(&args.file, MAX_MAP_SIDE)?, &choices)?
    } else {
        of_text(&origin, &regular_file::read_to_string(&args.file, MAX_TEXT_BYTES)?, &choices)?
    };
    let map = imported.map;
    write_atomically(&args.out, Durable::Now, |file| file.write_all(map.to_string().as_bytes()))
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    outln!("{origin}, {}", imported.form);
    for note in imported.notes {
        outln!("note: {note}");
    }
    let [start, goal] = [map.start(), map.goal()].map(|[column, row]| format!("{column},{row}"));
    outln!(
        "{}: {} columns, {} rows, {} free cells, start {start}, goal {goal}",
        args.out.display(),
        map.columns(),
        map.rows(),
        map.free_cells()
    );
    if let Err(error) =
        mentor_path(&args.out.display().to_string(), &map, &ActionSet::new("regular", REGULAR))
    {
        outln!("warning: {error}");
    }
    Ok(())
}
