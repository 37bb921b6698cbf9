// The page of one run.

import { AXES, Chart, axisLabel, dash, onAxis, short } from "./charts.js";
import { address, check, choice, count, duration, h, moment, number, percent, pill, say, show } from "./dom.js";
import { BridgeMap } from "./map.js";

const MAX_OTHERS = 6;
const last = (list) => {
  for (let at = (list ?? []).length - 1; at >= 0; at -= 1) if (list[at] !== null) return list[at];
  return undefined;
};

export class RunView {
  constructor(below) {
    this.below = below;
    this.axis = "episode";
    this.others = new Map();
    this.build();
    this.findOthers();
  }

  build() {
    this.title = h("h1", {}, this.below.split("/").at(-1) || "Run");
    this.pills = h("span", { class: "group" });
    this.subtitle = h("p", { class: "soft" });
    this.fault = h("p", { class: "note hidden", role: "alert" });
    this.fill = h("div", { class: "fill" });
    this.track = h("div", { class: "track", role: "progressbar", "aria-label": "Progress", "aria-valuemin": 0, "aria-valuemax": 100 }, this.fill);
    this.facts = h("p", { class: "facts" });
    this.tiles = {};
    const tile = (key, name) => {
      this.tiles[key] = h("dd", {}, "–");
      return h("div", {}, h("dt", {}, name), this.tiles[key]);
    };
    this.map = new BridgeMap(this.below);
    this.curve = new Chart({ label: "Learning curve", height: 300, y: "return" });
    this.compare = h("div", { class: "group" });
    this.speed = new Chart({ label: "Steps a second", height: 120, y: "", format: short, range: (_, low, high) => [0, high > 0 ? 1.1 * high : 1] });
    this.time = new Chart({ label: "Where the time goes", height: 160, y: "", range: () => [0, 1], format: percent });
    this.loss = new Chart({ label: "Loss", height: 170, y: "" });
    this.mentor = new Chart({ label: "The mentor's transitions", height: 170, y: "", range: () => [0, 1], format: percent });
    this.error = new Chart({ label: "Mean e_KL", height: 170, y: "" });
    this.explore = new Chart({ label: "Exploration", height: 170, y: "", range: () => [0, 1] });
    this.replay = new Chart({ label: "Replay", height: 170, y: "", format: short, range: (_, low, high) => [0, high > 0 ? 1.1 * high : 1] });
    this.memory = new Chart({ label: "Memory of the learner", height: 170, y: "MiB", format: (x) => String(Math.round(10 * x) / 10), range: (_, low, high) => [0, high > 0 ? 1.2 * high : 1] });
    this.actors = h("div", {});
    this.events = h("ul", { class: "events", tabindex: 0, "aria-label": "What happened to processes, the newest first" });
    this.tabs = h("div", { class: "group" });
    this.log = h("pre", { class: "log", tabindex: 0, "aria-label": "Last lines of the log" });
    this.settings = h("pre", { tabindex: 0, "aria-label": "config.toml" });
    const details = h("details", {}, h("summary", {}, "Settings of this run"), this.settings);
    details.addEventListener("toggle", () => details.open && this.loadSettings());
    this.command = h("code", {});
    this.built = h("p", { class: "soft small" });
    const card = (title, ...parts) => h("section", { class: "card", "aria-label": title }, h("header", {}, h("h2", {}, title)), ...parts);
    this.element = h("div", { class: "stack" },
      h("div", { class: "head" }, this.title, this.pills, this.subtitle), this.fault,
      h("div", { class: "progress" }, this.track, this.facts),
      h("dl", { class: "tiles" }, tile("last", "Last greedy"), tile("best", "Best greedy"), tile("threshold", "Threshold"),
        tile("feasible", "Feasible"), tile("bridged", "Bridged"), tile("loss", "Mentor in the loss"), tile("epsilon", "ε"), tile("replay", "Replay")),
      h("div", { class: "two" }, this.map.element,
        h("div", { class: "stack" },
          h("section", { class: "card", "aria-label": "Learning curve" },
            h("header", {}, h("h2", {}, "Learning curve"),
              choice("Over", AXES, this.axis, (axis) => { this.axis = axis; this.draw(); })),
            this.curve.element, this.compare),
          card("Where the time goes", this.speed.element, this.time.element))),
      h("div", { class: "three" }, card("Loss", this.loss.element), this.mentorCard = card("The mentor's transitions", this.mentor.element),
        this.errorCard = card("Mean e_KL", this.error.element), card("Exploration", this.explore.element), card("Replay", this.replay.element), this.memoryCard = card("Memory", this.memory.element)),
      h("div", { class: "two" }, card("Logs", this.tabs, this.log),
        h("div", { class: "stack" }, card("Actors", this.actors), card("Starts and restarts", this.events))),
      h("section", { class: "card", "aria-label": "How it was started" }, h("h2", {}, "How it was started"), this.command, this.built, details));
  }

  // The other runs beside this one, to compare with: the plain dqn first.
  async findOthers() {
    const parents = [];
    const names = this.below.split("/").filter(Boolean);
    if (!names.length) return;
    for (let at = names.length - 1; at >= 0 && at >= names.length - 2; at -= 1) parents.push(names.slice(0, at).join("/"));
    let rows = [];
    for (const parent of parents) {
      try {
        const folder = await (await fetch(address("state", parent))).json();
        rows = (folder.rows ?? []).filter((row) => row.below !== this.below);
      } catch {
        return;
      }
      if (rows.some((row) => row.arm === "dqn")) break;
    }
    this.rows = rows;
    this.offer();
  }

  offer() {
    if (!this.rows?.length || !this.state?.facts) return;
    const { env, seed } = this.state.facts;
    const task = (row) => row.env === env || this.state.facts.env.startsWith(row.env);
    const rank = (row) => [row.arm === "dqn" ? 0 : 1, row.seed === seed ? 0 : 1];
    const rows = this.rows.filter(task).sort((a, b) => rank(a)[0] - rank(b)[0] || rank(a)[1] - rank(b)[1] || a.below.localeCompare(b.below)).slice(0, MAX_OTHERS);
    this.rows = null;
    if (!rows.length) return;
    this.compare.append(h("span", { class: "soft small" }, "Beside it:"));
    rows.forEach((row, at) => {
      const first = at === 0 && row.arm === "dqn";
      this.compare.append(check(row.name, first, (on) => (on ? this.add(row, at) : this.remove(row))));
      if (first) this.add(row, at);
    });
  }

  async add(row, at) {
    try {
      const state = await (await fetch(address("state", row.below))).json();
      if (state.kind === "run") this.others.set(row.below, { row, at, state });
    } catch {
      return;
    }
    this.draw();
  }

  remove(row) {
    this.others.delete(row.below);
    this.draw();
  }

  async loadSettings() {
    let text = null;
    try {
      const answer = await fetch(address("settings", this.below));
      if (answer.ok) text = await answer.text();
    } catch {
      // There is no server any more.
    }
    say(this.settings, text ?? "config.toml cannot be read");
  }

  update(state) {
    this.state = state;
    const { facts, state: stand } = state;
    const name = this.below.split("/").at(-1) || state.path.split("/").filter(Boolean).at(-1) || "Run";
    say(this.title, name);
    document.title = `${stand === "running" ? percent(state.share) : stand} ${name} – Trestle`;
    const pills = [pill(stand)];
    if (state.optimal) pills.push(pill("solved", `Optimal from episode ${count(state.optimal.episode)}`));
    else if (state.solved) pills.push(pill("solved", `Solved at episode ${count(state.solved.episode)}`));
    if (this.pills.textContent !== pills.map((each) => each.textContent).join("")) this.pills.replaceChildren(...pills);
    say(this.subtitle, [facts.arm, facts.env, `seed ${facts.seed}`, facts.mode && `${facts.mode}, ${facts.actors} actor${facts.actors === 1 ? "" : "s"}`].filter(Boolean).join(" · "));
    const fault = facts.fault ?? (stand === "failed" ? state.reason : null);
    show(this.fault, !!fault);
    say(this.fault, fault ?? "");
    const share = Math.round(100 * state.share);
    this.fill.style.width = `${100 * state.share}%`;
    this.track.setAttribute("aria-valuenow", share);
    const of = (limit) => (limit ? ` of ${count(limit)}` : "");
    const fps = last(state.figures?.fps);
    this.facts.replaceChildren(...[
      ["episodes", `${count(state.episodes)}${of(facts.limit_episodes)}`], ["environment steps", `${count(state.env_steps)}${of(facts.limit_env_steps)}`],
      ["steps/s", count(fps)], ["so far", duration(state.wall_s)], state.left_s !== null && ["left", duration(state.left_s)],
      state.restarts > 0 && [state.restarts === 1 ? "restart" : "restarts", count(state.restarts)], state.read < 1 && ["of the records read", percent(state.read)],
    ].filter(Boolean).map(([what, value]) => h("span", {}, h("b", {}, value), ` ${what}`)));
    const figure = (key) => last(state.figures?.[key]);
    const tiles = {
      last: number(state.last_return ?? NaN), best: number(state.best_return ?? NaN), threshold: number(facts.threshold ?? NaN), feasible: percent(figure("feasible")), bridged: percent(figure("bridged")),
      loss: percent(figure("mentor_loss")), epsilon: number(figure("epsilon")), replay: count(figure("replay")),
    };
    for (const [key, text] of Object.entries(tiles)) say(this.tiles[key], text);
    const hasMentor = figure("feasible") !== undefined;
    for (const key of ["feasible", "bridged", "loss"]) show(this.tiles[key].parentElement, hasMentor);
    show(this.mentorCard, hasMentor);
    show(this.errorCard, hasMentor);
    show(this.memoryCard, figure("memory_mb") !== undefined);
    this.offer();
    this.draw();
    this.map.follow(state.timeline);
    this.tellActors();
    const events = (state.events ?? []).slice().reverse();
    if (this.events.dataset.newest !== JSON.stringify(events)) {
      this.events.dataset.newest = JSON.stringify(events);
      this.events.replaceChildren(...(events.length ? events.map(({ at, text }) => h("li", {}, h("time", {}, moment(at)), text)) : [h("li", { class: "soft" }, "No process has died, and the run was started once.")]));
    }
    this.tellLogs();
    say(this.command, facts.command);
    say(this.built, [facts.version && `Trestle ${facts.version}`, facts.commit && `commit ${facts.commit.slice(0, 12)}`, state.weights_sha256 && `weights ${state.weights_sha256.slice(0, 12)}`, state.path].filter(Boolean).join(" · "));
  }

  draw() {
    const { state, axis } = this;
    if (!state) return;
    const label = axisLabel[axis];
    const x = (table) => onAxis(axis, table?.[axis]);
    const evals = state.evals ?? {};
    const training = state.training?.return ? state.training : { ...state.figures };
    const lines = [
      { label: "training, mean of 100", color: "unseen", width: 1.5, x: training.return ? x(training) : [], y: training.return ?? [] },
      ...[...this.others.values()].map(({ row, at, state: other }) => ({
        label: `${row.name} (greedy)`, color: `c${(at % 5) + 1}`, dash: [6, 4], x: x(other.evals), y: other.evals?.return ?? [],
      })),
      { label: "greedy evaluation", color: "c0", width: 2.5, points: (evals.return ?? []).length < 60, x: x(evals), y: evals.return ?? [] },
    ];
    const all = lines.flatMap((line) => line.x);
    if (state.facts.threshold !== null && all.length) {
      lines.push({ label: "threshold", color: "c2", dash: [3, 4], width: 1.5, constant: true, x: [Math.min(...all), Math.max(...all)], y: [state.facts.threshold, state.facts.threshold] });
    }
    this.curve.set(lines, label);
    const figures = state.figures ?? {};
    const xs = x(figures);
    const one = (name, key, color = "c0", more = {}) => ({ label: name, color, x: figures[key] ? xs : [], y: figures[key] ?? [], ...more });
    this.speed.set([one("environment steps a second", "fps")], "");
    const waits = [one("waiting for actors", "wait_actors", "c1"), one("waiting for the mentor-server", "wait_mentor", "c4", { dash: dash(6) }), one("checkpoints", "checkpoints", "c3", { dash: dash(12) })];
    const wait = waits[0].x.length ? waits : [one("waiting for other processes", "wait", "c1")];
    const busy = (figures.wait ?? []).map((waited, at) => (waited === null ? null : Math.max(0, 1 - waited - (figures.checkpoints?.[at] ?? 0))));
    this.time.set([{ label: "learner", color: "c0", x: busy.length ? xs : [], y: busy }, ...wait], label);
    this.loss.set([one("loss", "loss")], label);
    this.mentor.set([one("feasible", "feasible", "feasible"), one("bridged", "bridged", "bridged", { dash: dash(6) }), one("in the loss", "mentor_loss", "c2", { dash: dash(12) })], label);
    this.error.set([one("mean e_KL", "e_kl")], label);
    this.explore.set([one("ε", "epsilon")], label);
    this.replay.set([one("stored transitions", "replay")], label);
    this.memory.set([one("resident, MiB", "memory_mb")], label);
  }

  tellActors() {
    const { actors, facts } = this.state;
    const key = JSON.stringify([actors, facts.actors, facts.mode]);
    if (this.actorsKey === key) return;
    this.actorsKey = key;
    if (!actors?.length) {
      const text = facts.mode === "lockstep" ? `${count(facts.actors)} in lockstep: all act with the same weights, and none is replaced on its own.`
        : facts.mode === "reference" ? "None: the run is one process." : "The table comes with the first checkpoint.";
      this.actors.replaceChildren(h("p", { class: "soft small" }, text));
      return;
    }
    const heads = ["actor", "incarnation", "batches", "steps", "staleness", "most"];
    // Where other hosts lend actors to the run.
    if (actors.some((row) => row[6])) heads.push("host");
    this.actors.replaceChildren(h("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Table of actors" }, h("table", {},
      h("thead", {}, h("tr", {}, heads.map((head) => h("th", { scope: "col" }, head)))),
      h("tbody", {}, actors.map((row) => h("tr", {}, row.slice(0, heads.length).map((cell, at) => h("td", {}, at === 1 ? incarnation(cell) : cell === "" ? "–" : cell))))))));
  }

  tellLogs() {
    const logs = this.state.logs ?? [];
    // The last words of the process that a run failed with are looked for first.
    const died = this.state.state === "failed" && logs.find((log) => String(this.state.reason).startsWith(`${log.process} `))?.process;
    const names = [died, ...logs.map((log) => log.process)].join();
    if (this.logNames !== names) {
      this.logNames = names;
      this.process = died || logs.find((log) => log.process === this.process)?.process || logs.find((log) => log.process === "learner")?.process || logs[0]?.process;
      this.tabs.replaceChildren(...(logs.length ? [choice("Process", logs.map((log) => [log.process, log.process]), this.process, (process) => {
        this.process = process;
        this.tellLogs();
        this.log.scrollTop = this.log.scrollHeight;
      })] : []));
    }
    const lines = logs.find((log) => log.process === this.process)?.lines ?? [];
    const atEnd = this.log.scrollHeight - this.log.scrollTop - this.log.clientHeight < 8;
    say(this.log, lines.length ? lines.join("\n") : "Nothing logged yet.");
    if (atEnd) this.log.scrollTop = this.log.scrollHeight;
  }
}

// The learner's starts in the upper half of the number, the actor's own in the lower one.
function incarnation(cell) {
  const all = Number(cell);
  if (!Number.isFinite(all)) return cell;
  const [start, own] = [Math.floor(all / 65536), all % 65536];
  return start ? `${own} (start ${start})` : String(own);
}
