// The page of a sweep or a folder of runs.

import { AXES, Chart, axisLabel, dash, onAxis } from "./charts.js";
import { address, choice, count, duration, h, number, percent, pill, say, show } from "./dom.js";

const STATES = ["running", "starting", "finished", "interrupted", "failed", "nothing"];
// Title, value to sort by, cell.
const COLUMNS = [
  ["run", (row) => row.name, null],
  ["arm", (row) => row.arm, (row) => row.arm],
  ["seed", (row) => row.seed, (row) => String(row.seed)],
  ["state", (row) => STATES.indexOf(row.state), null],
  ["progress", (row) => row.share, null],
  ["episodes", (row) => row.episodes, (row) => count(row.episodes)],
  ["steps", (row) => row.env_steps, (row) => count(row.env_steps)],
  ["last return", (row) => row.last_return ?? -Infinity, (row) => number(row.last_return ?? NaN)],
  ["best", (row) => row.best_return ?? -Infinity, (row) => number(row.best_return ?? NaN)],
  ["solved at", (row) => row.solved_episode ?? Infinity, (row) => (row.solved_episode === null ? "–" : `episode ${count(row.solved_episode)}`)],
  ["time", (row) => row.wall_s, (row) => duration(row.wall_s)],
];

export class FolderView {
  constructor(below) {
    this.below = below;
    this.axis = "env_steps";
    this.sort = [0, 1];
    this.filter = "";
    this.rows = new Map();
    this.build();
  }

  build() {
    this.title = h("h1", {}, "Runs");
    this.pills = h("span", { class: "group" });
    this.subtitle = h("p", { class: "soft" });
    this.tiles = {};
    const tile = (key, name) => {
      this.tiles[key] = h("dd", {}, "–");
      return h("div", {}, h("dt", {}, name), this.tiles[key]);
    };
    this.fill = h("div", { class: "fill" });
    this.track = h("div", { class: "track", role: "progressbar", "aria-label": "Runs done", "aria-valuemin": 0, "aria-valuemax": 100 }, this.fill);
    this.tasks = h("span", {});
    this.chart = new Chart({ label: "Greedy return by arm", height: 320, y: "return" });
    this.chartCard = h("section", { class: "card", "aria-label": "Learning curves" },
      h("header", {}, h("h2", {}, "Learning curves by arm"), h("span", { class: "group" }, this.tasks,
        choice("Over", AXES, this.axis, (axis) => { this.axis = axis; this.draw(); }))),
      this.chart.element, h("p", { class: "soft small" }, "Greedy return: the median of an arm's runs, and the middle half of them as a band. A run that is over stays where it ended."));
    this.arms = h("tbody", {});
    this.armCard = h("section", { class: "card", "aria-label": "Arms" }, h("h2", {}, "Arms"),
      h("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Table of arms" }, h("table", {},
        h("thead", {}, h("tr", {}, ["arm", "runs", "solved", "share"].map((head, at) => h("th", { scope: "col", class: at ? null : "name" }, head)))), this.arms)));
    const search = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter runs" });
    search.addEventListener("input", () => { this.filter = search.value.toLowerCase(); this.list(); });
    this.heads = COLUMNS.map(([title], at) => h("th", { scope: "col", class: at < 2 ? "name" : null, "aria-sort": at === 0 ? "ascending" : "none" },
      h("button", { type: "button", onclick: () => this.order(at) }, title)));
    this.body = h("tbody", {});
    this.shown = h("p", { class: "soft small" });
    this.table = h("section", { class: "card", "aria-label": "Runs" }, h("header", {}, h("h2", {}, "Runs"), search),
      h("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Table of runs" }, h("table", {}, h("thead", {}, h("tr", {}, this.heads)), this.body)), this.shown);
    this.none = h("section", { class: "card hero hidden" },
      h("svg", { viewBox: "0 0 32 32", "aria-hidden": "true" }, h("path", { d: "M2 9h28M7 9 3 25M7 9l4 16M16 9l-5 16M16 9l5 16M25 9l-4 16M25 9l4 16" })),
      h("h2", {}, "No run here yet"), h("p", {}, "Start one in another terminal, and it comes up here by itself:"), h("p", {}, h("code", {}, "trestle train maze-small --algo trestle")));
    this.some = h("div", { class: "stack" }, h("div", { class: "progress" }, this.track),
      h("dl", { class: "tiles" }, tile("runs", "Runs"), tile("running", "Running"), tile("finished", "Finished"), tile("failed", "Failed"), tile("interrupted", "Interrupted"), tile("solved", "Solved so far"), tile("left", "Time left")),
      this.two = h("div", { class: "two" }, this.chartCard, this.armCard), this.table);
    this.element = h("div", { class: "stack" }, h("div", { class: "head" }, this.title, this.pills, this.subtitle), this.none, this.some);
  }

  order(column) {
    this.sort = this.sort[0] === column ? [column, -this.sort[1]] : [column, 1];
    this.heads.forEach((head, at) => head.setAttribute("aria-sort", at !== column ? "none" : this.sort[1] > 0 ? "ascending" : "descending"));
    this.list();
  }

  update(state) {
    this.state = state;
    const name = this.below.split("/").at(-1) || state.path.split("/").filter(Boolean).at(-1) || "Runs";
    say(this.title, name);
    const all = Math.max(state.runs, state.planned ?? 0);
    const of = (key) => state.counts[key] ?? 0;
    const running = of("running") + of("starting");
    document.title = `${running ? `${count(of("finished"))}/${count(all)} ` : ""}${name} – Trestle`;
    say(this.subtitle, [state.sweep === null ? "Folder of runs" : `Sweep of ${state.sweep}`, state.path].join(" · "));
    const stand = running ? "running" : of("failed") ? "failed" : all > 0 && of("finished") === all ? "finished" : null;
    this.pills.replaceChildren(...(stand ? [pill(stand, stand === "failed" ? `${count(of("failed"))} failed` : undefined)] : []));
    show(this.none, state.runs === 0);
    show(this.some, state.runs > 0);
    if (state.runs === 0) return;
    const tiles = {
      runs: state.planned > state.runs ? `${count(state.runs)} of ${count(state.planned)}` : `${count(state.runs)}${state.more ? "+" : ""}`,
      running: count(running), finished: count(of("finished")), failed: count(of("failed")), interrupted: count(of("interrupted")),
      solved: `${count(state.solved)} (${percent(state.solved / state.runs)})`, left: state.left_s === null ? "–" : duration(state.left_s),
    };
    for (const [key, text] of Object.entries(tiles)) say(this.tiles[key], text);
    const share = all ? state.rows.reduce((sum, row) => sum + row.share, 0) / Math.max(all, state.rows.length) : 0;
    this.fill.style.width = `${100 * share}%`;
    this.track.setAttribute("aria-valuenow", Math.round(100 * share));
    const tasks = state.arms.map((task) => task.task);
    if (this.taskNames !== tasks.join("\n")) {
      this.taskNames = tasks.join("\n");
      this.task = tasks.includes(this.task) ? this.task : tasks[0];
      const select = h("select", { "aria-label": "Task", onchange: (event) => { this.task = event.target.value; this.draw(); } },
        tasks.map((task) => h("option", { value: task, selected: task === this.task }, task)));
      this.tasks.replaceChildren(...(tasks.length > 1 ? [select] : []));
      show(this.tasks, tasks.length > 1);
    }
    this.draw();
    this.list();
  }

  draw() {
    const task = this.state?.arms.find((each) => each.task === this.task);
    if (!task) return;
    const lines = task.arms.map((arm, at) => {
      const curve = arm.curves[this.axis] ?? { x: [], mid: [] };
      const several = arm.runs > 1;
      return { label: arm.arm, color: `c${at % 6}`, dash: dash(at), x: onAxis(this.axis, curve.x), y: curve.mid, low: several ? curve.low : null, high: several ? curve.high : null };
    });
    const all = lines.flatMap((line) => line.x);
    if (task.threshold !== null && all.length) {
      lines.push({ label: "threshold", color: "unseen", dash: [3, 4], width: 1.5, constant: true, x: [0, Math.max(...all)], y: [task.threshold, task.threshold] });
    }
    this.chart.set(lines, axisLabel[this.axis]);
    const cells = task.arms.map((arm) => [arm.arm, count(arm.runs), count(arm.solved), percent(arm.solved / arm.runs)]);
    if (this.armKey === JSON.stringify(cells)) return;
    this.armKey = JSON.stringify(cells);
    this.arms.replaceChildren(...cells.map((row) => h("tr", {}, row.map((cell, at) => h("td", { class: at ? null : "name" }, cell)))));
  }

  list() {
    const { rows } = this.state;
    const [column, way] = this.sort;
    const key = COLUMNS[column][1];
    const found = rows.filter((row) => `${row.name} ${row.arm} ${row.env} ${row.state}`.toLowerCase().includes(this.filter));
    found.sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      return way * (typeof x === "string" ? x.localeCompare(y, "en", { numeric: true }) : x - y || a.name.localeCompare(b.name, "en", { numeric: true }));
    });
    const elements = found.map((row) => this.row(row));
    const same = elements.length === this.body.children.length && elements.every((element, at) => element === this.body.children[at]);
    if (!same) this.body.replaceChildren(...elements);
    const left = this.state.runs - rows.length;
    say(this.shown, [found.length < rows.length ? `${count(found.length)} of ${count(rows.length)} shown` : "", left > 0 ? `${count(left)} more runs are counted and not listed; open a folder below this one` : "", this.state.more ? "there are more runs than are looked at" : "", this.state.whole ? "" : "still reading"].filter(Boolean).join("; "));
  }

  row(row) {
    let known = this.rows.get(row.below);
    if (!known) {
      const fill = h("div", { class: "fill" });
      const text = h("span", {});
      const cells = COLUMNS.map(([title], at) => h("td", { class: at < 2 ? "name" : null },
        title === "run" ? h("a", { href: address("run", row.below) }, row.name) : title === "progress" ? [h("span", { class: "track" }, fill), " ", text] : null));
      known = { element: h("tr", {}, cells), cells, fill, text };
      this.rows.set(row.below, known);
    }
    COLUMNS.forEach(([title, , cell], at) => {
      if (cell) say(known.cells[at], cell(row));
      else if (title === "state" && known.state !== row.state) {
        known.state = row.state;
        known.cells[at].replaceChildren(pill(row.state));
      }
    });
    known.fill.style.width = `${100 * row.share}%`;
    say(known.text, percent(row.share));
    known.element.title = row.reason ?? "";
    return known.element;
  }
}
