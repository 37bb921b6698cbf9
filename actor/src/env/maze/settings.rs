//! `[env.maze]`

use crate::env::grid::{self, ActionSet, ActionSets, GridError, IRREGULAR, Map, REGULAR};
use std::collections::BTreeMap;
use trestle_proto::config::accepts::any;
use trestle_proto::settings;

settings! {
    /// `[env.maze]`
    pub struct Settings {
        /// The map. The seed `run` of a random map is the run's own. Its sides are 4 to 1000 cells long, with other generators than `random` 5, 8 or 11 to 1000.
        map: String = "maze-small".into(), any(grid::ACCEPTED);
        /// The map's text itself. It is filled in when the configuration is resolved, so that a run needs no other file.
        map_text: Option<String> = None, any::<String>("the text of the map that `map` names");
        /// The observer's action set.
        actions: String = "irregular".into(), any("regular, irregular, or a key of `action_sets`");
        /// More action sets by name. The order of a set's directions breaks ties of the planner.
        action_sets: BTreeMap<String, Vec<String>> = BTreeMap::new(),
            any("name = 2 to 8 different ones of N, NE, E, SE, S, SW, W, NW");
    }
}

impl Settings {
    /// The map of resolved settings.
    ///
    /// # Errors
    /// There is no text, or it is no map.
    pub fn map(&self) -> Result<Map, GridError> {
        grid::map_of(&self.map, self.map_text.as_deref())
    }

    /// The action set that the setting `key` calls `name`.
    ///
    /// # Errors
    /// No set of this name, or any set of the configuration that cannot be used.
    pub fn action_set(&self, key: &'static str, name: &str) -> Result<ActionSet, GridError> {
        let builtin = &[("regular", REGULAR), ("irregular", IRREGULAR)];
        ActionSets { builtin, own: &self.action_sets }.find(key, name)
    }
}
