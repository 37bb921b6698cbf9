// The bridge map: the mentor's path with what has been found out about each of its steps, the bridges between them, where the
// agent goes, and a slider back through the run. It is drawn on the map, over two features of a state, or along the mentor's time.

import { Chart } from "./charts.js";
import { address, check, choice, color, count, duration, h, number, percent, say, show } from "./dom.js";

const KINDS = [
  ["f", "feasible", "One of the agent's own actions does the same"],
  ["b", "bridged", "No action does, but a bridge leads back onto the path"],
  ["g", "gated", "No action does and no bridge is known: its loss is not used"],
  ["u", "unseen", "The agent has not been near"],
];
// Where the mentor's path is only led along, as with learned bridges.
const LED = [["r", "reached", "The agent has been near"], KINDS[3]];
// How an action's name points, columns to the right and rows downwards.
const WAYS = {
  n: [0, -1], ne: [1, -1], e: [1, 0], se: [1, 1], s: [0, 1], sw: [-1, 1], w: [-1, 0], nw: [-1, -1],
  north: [0, -1], east: [1, 0], south: [0, 1], west: [-1, 0], up: [0, -1], right: [1, 0], down: [0, 1], left: [-1, 0],
};
const VIRIDIS = [[68, 1, 84], [68, 57, 131], [49, 104, 142], [33, 145, 140], [53, 183, 121], [144, 215, 67], [253, 231, 37]];
// Features that are offered, squares along the side of a cell, and squares of a map, at most: the numbers of a file are not trusted.
const MAX_DIMS = 8;
const MAX_FINE = 16;
const MAX_SQUARES = 2e6;
const still = matchMedia("(prefers-reduced-motion: reduce)");

function way(name) {
  const [word, size] = String(name).split(" ");
  const direction = WAYS[word.toLowerCase()];
  if (!direction) return null;
  const long = Math.hypot(...direction) * (Number(size) < 0.5 ? 1.6 : 1);
  return direction.map((x) => x / long);
}

function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const low = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return [0, 1, 2].map((i) => VIRIDIS[low][i] + (at - low) * (VIRIDIS[low + 1][i] - VIRIDIS[low][i]));
}

const near = (x) => Number(x.toFixed(3));
const array = (x) => (Array.isArray(x) ? x : []);

// A mark of each kind: filled circle, diamond, cross in a ring, small ring.
function mark(kind, x, y, r) {
  if (kind === "b") return h("path", { class: "node k-b", d: `M${x} ${y - 1.35 * r}L${x + 1.35 * r} ${y}L${x} ${y + 1.35 * r}L${x - 1.35 * r} ${y}Z` });
  if (kind === "g") return h("path", { class: "node k-g", d: `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}ZM${x - r} ${y - r}l${2 * r} ${2 * r}` });
  return h("circle", { class: `node k-${kind}`, cx: x, cy: y, r: kind === "u" ? 0.7 * r : r });
}

function sample(kind) {
  return h("svg", { viewBox: "0 0 32 16", "aria-hidden": "true" },
    h("path", { class: `line k-${kind}`, d: "M2 8H30" }), mark(kind, 16, 8, 4));
}

export class BridgeMap {
  constructor(below) {
    this.below = below;
    this.edition = null;
    this.moments = [];
    this.chosen = null;
    this.picked = null;
    this.layer = "visits";
    this.shown = { actions: true, bridges: true, path: true, visits: true };
    this.axes = [0, 1];
    this.build();
  }

  build() {
    this.stage = h("div", { class: "stage" });
    this.views = h("div", { class: "group" });
    this.legend = h("ul", { class: "kinds" });
    this.slider = h("input", { type: "range", min: 0, max: 0, value: 0, step: 1, "aria-label": "Moment of the run" });
    this.slider.addEventListener("input", () => this.choose(Number(this.slider.value)));
    this.live = h("button", { type: "button", onclick: () => this.choose(null) }, "Latest");
    this.when = h("output", {});
    this.scale = h("p", { class: "soft small" });
    this.layers = h("div", { class: "group" },
      choice("Background", [["visits", "Visits"], ["values", "Values"], ["none", "Plain"]], this.layer, (layer) => {
        this.layer = layer;
        this.draw();
      }),
      check("Greedy actions", true, (on) => this.toggle("actions", on)),
      check("Bridges", true, (on) => this.toggle("bridges", on)),
      check("Last evaluation", true, (on) => this.toggle("path", on)),
      check("Visits", true, (on) => this.toggle("visits", on)));
    this.stepText = h("p", { class: "soft small" });
    this.stepFacts = h("dl", {});
    this.stepNow = h("b", {});
    this.step = h("section", { class: "step", "aria-label": "Mentor step" },
      h("div", { class: "row" }, h("h3", {}, "Mentor step ", this.stepNow),
        h("span", {}, h("button", { type: "button", "aria-label": "Step before", onclick: () => this.pick(this.picked - 1) }, "←"), " ",
          h("button", { type: "button", "aria-label": "Step after", onclick: () => this.pick(this.picked + 1) }, "→"))),
      this.pair = h("div", { class: "pair" }, this.stepFacts));
    this.hint = h("p", { class: "soft small" }, "Click on a step of the mentor's path to see the findings about it.");
    this.none = h("p", { class: "empty" }, "The map comes with the first moment of the run.");
    this.body = h("div", { class: "map hidden" },
      h("div", { class: "stack" }, this.stage, h("div", { class: "time" }, this.slider, this.live, this.when)),
      h("div", { class: "side" }, this.legend, this.layers, this.scale, this.hint), this.step);
    this.element = h("section", { class: "card", "aria-labelledby": "map-title" },
      h("header", {}, this.title = h("h2", { id: "map-title" }, "Bridge map"), this.views), this.none, this.body);
    this.stage.addEventListener("click", (event) => this.pickAt(event));
  }

  toggle(what, on) {
    this.shown[what] = on;
    this.draw();
  }

  // Fetches what is new; one request at a time.
  async follow(extent) {
    this.wanted = extent;
    if (this.fetching || !extent || extent.lines === 0) {
      if (!extent || extent.lines === 0) say(this.none, "This run has written no moments for a map (timeline.jsonl).");
      return;
    }
    this.fetching = true;
    let more = false;
    try {
      while (this.wanted.edition !== this.edition || this.wanted.lines > this.moments.length + 1) {
        const from = this.wanted.edition === this.edition ? this.moments.length + 1 : 0;
        const answer = await fetch(address(`timeline/${from}`, this.below));
        if (!answer.ok) break;
        const part = await answer.json();
        if (from === 0 || part.edition !== this.edition) {
          if (from !== 0) {
            this.edition = null;
            continue;
          }
          this.begin(part.head, part.edition);
        }
        if (!part.moments.length) break;
        more = true;
        this.moments.push(...part.moments.map((moment) => moment ?? {}));
      }
      if (more) this.refresh();
    } catch {
      // The next state tries again.
    } finally {
      this.fetching = false;
    }
  }

  begin(head, edition) {
    const first = !this.head;
    [this.edition, this.moments, this.head] = [edition, [], head ?? {}];
    this.cells = this.squares(this.head.map);
    const map = this.cells;
    const mentor = (this.head.mentor ??= {});
    this.dims = Math.min(MAX_DIMS, Math.max(1, Math.floor(Number(this.head.dims)) || 1));
    const points = (flat) => {
      const found = [];
      for (let at = 0; at + this.dims <= array(flat).length; at += this.dims) found.push(flat.slice(at, at + this.dims).map(Number));
      return found;
    };
    this.points = points;
    this.from = points(mentor.from);
    this.to = points(mentor.to);
    this.stride = Math.max(1, Number(mentor.stride) || 1);
    this.ways = array(this.head.actions).map(way);
    if (!first) return;
    this.history = mentor.led ? new Chart({ label: "Probability of the likeliest action over the run", height: 130, range: () => [0, 1], format: percent })
      : new Chart({ label: "e_KL of the mentor step over the run", height: 130, log: true, format: (x) => (x > 0 ? x.toPrecision(2) : "0") });
    this.pair.append(this.history.element);
    const views = [];
    if (map) views.push(["map", "Map"]);
    else if (this.dims > 1) views.push(["features", "Features"]);
    if (this.from.length) views.push(["time", "Mentor's time line"]);
    this.view = views[0]?.[0];
    const controls = [];
    if (views.length > 1) controls.push(choice("View", views, this.view, (view) => { this.view = view; this.draw(); this.arrange(); }));
    if (!map && this.dims > 1) {
      this.selects = [0, 1].map((axis) => h("select", { "aria-label": axis ? "Upwards" : "To the right" },
        Array.from({ length: this.dims }, (_, feature) => h("option", { value: feature, selected: feature === axis }, `feature ${feature}`))));
      this.selects.forEach((select, axis) => select.addEventListener("change", () => { this.axes[axis] = Number(select.value); this.draw(); }));
      controls.push(h("span", { class: "group" }, ...this.selects));
    }
    this.views.replaceChildren(...controls);
    this.kinds = mentor.led ? LED : KINDS;
    this.legend.replaceChildren(...this.kinds.map(([kind, name, about]) => {
      const total = h("b", {});
      this[`n${kind}`] = total;
      return h("li", { title: about }, sample(kind), h("span", {}, name), total);
    }));
    show(this.legend, this.from.length > 0);
    show(this.hint, this.from.length > 0);
    say(this.title, !this.from.length ? "Map" : mentor.led ? "The mentor's path" : "Bridge map");
    this.arrange();
  }

  arrange() {
    const onMap = this.view === "map";
    show(this.layers.firstChild, onMap && this.head.squares);
    show(this.layers.children[1], onMap && this.head.squares);
    show(this.layers.children[2], this.from.length > 0 && !this.head.mentor.led);
    show(this.layers.children[3], this.view !== "time");
    show(this.layers.children[4], !onMap);
    if (this.selects) this.selects.forEach((select) => show(select, this.view === "features"));
  }

  // Which pixel of the background each free square is, in the order in which moments tell of them; none without a map.
  squares(map) {
    const rows = array(map?.rows).map(String);
    const [columns, fine] = [rows[0]?.length ?? 0, Math.min(MAX_FINE, Math.max(1, Math.floor(Number(this.head.squares)) || 1))];
    const total = columns * rows.length * fine * fine;
    if (total === 0 || total > MAX_SQUARES) return null;
    const free = [];
    for (let row = 0; row < rows.length * fine; row += 1) {
      for (let column = 0; column < columns * fine; column += 1) {
        if (rows[Math.floor(row / fine)][Math.floor(column / fine)] !== "#") free.push([column, row]);
      }
    }
    return { rows, columns, fine, free, width: columns * fine, height: rows.length * fine };
  }

  get at() {
    return this.chosen === null ? this.moments.length - 1 : Math.min(this.chosen, this.moments.length - 1);
  }

  get now() {
    return this.moments[this.at] ?? {};
  }

  // Something new is there.
  refresh() {
    if (!this.moments.length) return;
    show(this.none, false);
    show(this.body, true);
    this.slider.max = this.moments.length - 1;
    if (this.chosen === null) this.slider.value = this.moments.length - 1;
    if (this.picked === null && this.from.length) this.picked = 0;
    this.draw();
  }

  choose(index) {
    this.chosen = index === null || index >= this.moments.length - 1 ? null : index;
    this.slider.value = this.at;
    this.draw();
  }

  pick(step) {
    if (!this.from.length) return;
    this.picked = Math.min(Math.max(step, 0), this.from.length - 1);
    this.draw();
  }

  pickAt(event) {
    const svg = this.stage.querySelector("svg");
    if (!svg || !this.from.length) return;
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    let best = [Infinity, 0];
    this.from.forEach((_, step) => {
      const [x, y] = this.place(step);
      const far = Math.hypot(x - place.x, y - place.y);
      if (far < best[0]) best = [far, step];
    });
    this.pick(best[1]);
  }

  kind(step) {
    const kind = String(this.now.kind ?? "")[step];
    return "fbgur".includes(kind ?? "?") ? kind : "u";
  }

  draw() {
    if (!this.head || !this.moments.length) return;
    const now = this.now;
    const totals = { f: 0, b: 0, g: 0, u: 0, r: 0 };
    this.from.forEach((_, step) => { totals[this.kind(step)] += 1; });
    for (const [kind] of this.kinds) if (this[`n${kind}`]) say(this[`n${kind}`], count(totals[kind]));
    const live = this.chosen === null;
    say(this.when, `Episode ${count(now.episodes)}, ${count(now.env_steps)} environment steps, after ${duration(now.wall_s)}${live ? " (latest)" : ""}`);
    this.slider.setAttribute("aria-valuetext", this.when.textContent);
    this.live.disabled = live;
    cancelAnimationFrame(this.frame);
    if (this.view === "map") this.drawMap();
    else if (this.view === "features") this.drawFeatures();
    else if (this.view === "time") this.drawTime();
    this.drawStep();
  }

  drawMap() {
    const { rows, columns, fine, free, width, height } = this.cells;
    const canvas = this.canvas ??= h("canvas", { "aria-hidden": "true" });
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    context.fillStyle = color("wall");
    rows.forEach((row, y) => [...row].forEach((cell, x) => { if (cell === "#") context.fillRect(x * fine, y * fine, fine, fine); }));
    const looks = this.now.squares;
    const shades = Number(this.head.shades) || 255;
    const numbers = this.layer === "none" || !looks ? [] : array(looks[this.layer]);
    const heat = color("heat");
    free.forEach(([x, y], at) => {
      const share = Number(numbers[at]) / shades;
      if (!(share >= 0)) return;
      if (this.layer === "values") context.fillStyle = `rgb(${viridis(share).map(Math.round).join(" ")} / 70%)`;
      else context.fillStyle = `rgb(${heat} / ${(75 * Math.sqrt(share)).toFixed(1)}%)`;
      context.fillRect(x, y, 1, 1);
    });
    const range = array(looks?.values_range);
    say(this.scale, this.layer === "values" && looks ? `Values: the largest Q of each square, ${number(range[0])} (dark) to ${number(range[1])} (light)`
      : this.layer === "visits" && looks ? `Visits: darker where the agent was more often lately; one counts half after ${count(this.head.visits_half_life)} steps` : "");
    const parts = [];
    if (this.shown.actions && looks) parts.push(h("path", { class: "arrows", d: this.arrows(array(looks.policy)) }));
    const length = this.length();
    parts.push(...this.scene((point) => point, Math.min(0.22, 0.3 * length), length));
    // In small cells the marks are larger than a cell, so that their letters have 12 pixels.
    const pixels = (this.stage.clientWidth || 480) / columns;
    const round = near(Math.max(0.36, 12 / (1.4 * pixels)));
    const letters = [["S", this.head.map.ends?.[0]], ["G", this.head.map.ends?.[1]]];
    for (const [letter, place] of letters) {
      const [x, y] = array(place).map(Number);
      if (Number.isFinite(x + y)) parts.push(h("circle", { class: "end", cx: x, cy: y, r: round }), h("text", { class: "letter", x, y, "font-size": near(1.4 * round) }, letter));
    }
    this.put(`-0.5 -0.5 ${columns} ${rows.length}`, parts, canvas, columns / rows.length);
  }

  // Length of the mentor's middle step, cells.
  length() {
    const lengths = this.from.map((point, step) => Math.hypot(...point.map((x, axis) => x - this.to[step][axis]))).filter((x) => x > 0);
    lengths.sort((a, b) => a - b);
    return lengths[Math.floor(lengths.length / 2)] ?? 1;
  }

  arrows(policy) {
    const { free, fine } = this.cells;
    const parts = [];
    free.forEach(([column, row], at) => {
      const direction = this.ways[policy[at]];
      if (!direction) return;
      const [x, y] = [column, row].map((place) => (place + 0.5) / fine - 0.5);
      const [dx, dy] = direction.map((d) => (0.3 * d) / fine);
      const [a, b] = [x + dx, y + dy];
      const [hx, hy] = [0.45 * dx, 0.45 * dy];
      parts.push(`M${near(x - dx)} ${near(y - dy)}L${near(a)} ${near(b)}M${near(a - hx - hy)} ${near(b - hy + hx)}L${near(a)} ${near(b)}L${near(a - hx + hy)} ${near(b - hy - hx)}`);
    });
    return parts.join("");
  }

  // The mentor's path, the bridges, the evaluation's path and the step that is picked, where `to` puts a point.
  scene(to, radius, length) {
    const parts = [];
    const lines = { f: [], b: [], g: [], u: [], r: [] };
    const ends = this.from.map((point, step) => [to(point), to(this.to[step])].map((place) => place.map(near)));
    ends.forEach(([a, b], step) => lines[this.kind(step)].push(`M${a}L${b}`));
    const whole = Object.values(lines).flat().join("");
    if (whole) parts.push(h("path", { class: "halo", d: whole, "stroke-width": 6 }));
    for (const [kind] of [...this.kinds].reverse()) if (lines[kind].length) parts.push(h("path", { class: `line k-${kind}`, d: lines[kind].join("") }));
    if (this.shown.bridges) parts.push(...this.arcs(ends.map(([a]) => a), length));
    if (this.shown.path) parts.push(...this.evaluation(to, radius));
    if (this.from.length <= 160) ends.forEach(([a], step) => parts.push(mark(this.kind(step), a[0], a[1], radius)));
    this.places = ends.map(([a]) => a);
    const place = this.places[this.picked];
    if (place) parts.push(h("circle", { class: "pick", cx: place[0], cy: place[1], r: near(2.1 * radius) }));
    return parts;
  }

  place(step) {
    return this.places?.[step] ?? [0, 0];
  }

  // An arc from where a bridge begins to the mentor state that it reaches: thin and faint if it is old.
  arcs(places, length) {
    const now = this.now;
    const steps = Number(now.env_steps) || 1;
    const parts = [];
    places.forEach(([x, y], step) => {
      if (this.kind(step) !== "b") return;
      const [span, ahead, found] = [now.bridge, now.ahead, now.found].map((list) => Number(array(list)[step]));
      const end = places[step + Math.max(1, Math.round((ahead || span) / this.stride))] ?? this.lastPlace(step);
      if (!end || !(span > 0)) return;
      const [dx, dy] = [end[0] - x, end[1] - y];
      const far = Math.hypot(dx, dy) || length;
      const bulge = 0.35 + 0.25 * (length / far);
      const [cx, cy] = [(x + end[0]) / 2 + dy * bulge, (y + end[1]) / 2 - dx * bulge];
      const fresh = 1 - Math.min(1, (steps - found) / (0.25 * steps));
      const arc = h("path", {
        class: step === this.picked ? "arc picked" : "arc", d: `M${x} ${y}Q${near(cx)} ${near(cy)} ${end[0]} ${end[1]}`,
        "stroke-width": step === this.picked ? 3 : near(1.8 + fresh), opacity: near(0.75 + 0.25 * fresh),
      }, h("title", {}, `Bridge of ${span} steps from mentor step ${step * this.stride}, known for ${count(steps - found)} environment steps`));
      parts.push(arc);
    });
    return parts;
  }

  // Where the mentor's trajectory ends that `step` is in.
  lastPlace(step) {
    const point = this.to[step];
    return point && this.toPlace ? this.toPlace(point) : null;
  }

  evaluation(to, radius) {
    const points = this.points(this.now.path).map((point) => to(point).map(near));
    if (points.length < 2) return [];
    const line = `M${points.map((point) => point.join(" ")).join("L")}`;
    const walker = h("circle", { class: "walker", cx: points.at(-1)[0], cy: points.at(-1)[1], r: near(1.2 * radius) });
    if (!still.matches) this.walk(walker, points);
    return [h("path", { class: "halo", d: line, "stroke-width": 5 }), h("path", { class: "learnt", d: line }), walker];
  }

  // The evaluation's path in motion, over and over.
  walk(walker, points) {
    const [pace, pause] = [Math.max(40, Math.min(160, 6000 / points.length)), 1200];
    const round = points.length * pace + pause;
    const step = (time) => {
      if (!walker.isConnected && walker.parentNode) return;
      const at = Math.min((time % round) / pace, points.length - 1);
      const [low, high] = [points[Math.floor(at)], points[Math.ceil(at)]];
      const part = at - Math.floor(at);
      walker.setAttribute("cx", low[0] + part * (high[0] - low[0]));
      walker.setAttribute("cy", low[1] + part * (high[1] - low[1]));
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  drawFeatures() {
    const [a, b] = this.axes;
    const visits = this.shown.visits ? this.points(this.now.states) : [];
    const states = [...this.from, ...this.to, ...this.points(this.now.path), ...visits];
    const bounds = [a, b].map((axis) => {
      const values = states.map((state) => state[axis]).filter(Number.isFinite);
      const [low, high] = [Math.min(...values), Math.max(...values)];
      return [low, high > low ? high : low + 1];
    });
    const letter = this.letter();
    const [width, height, margin] = [100, 66, Math.max(7, 2.4 * letter)];
    const to = (state) => [
      margin + ((state[a] - bounds[0][0]) / (bounds[0][1] - bounds[0][0])) * (width - 2 * margin),
      height - margin - ((state[b] - bounds[1][0]) / (bounds[1][1] - bounds[1][0])) * (height - 2 * margin),
    ];
    this.toPlace = to;
    const text = (x, y, anchor, words) => h("text", { class: "tick", x, y, "font-size": letter, "text-anchor": anchor }, words);
    const parts = [
      h("path", { class: "axis", d: `M${margin} ${margin}V${height - margin}H${width - margin}` }),
      text(margin, height - 3, "start", number(bounds[0][0])), text(width - margin, height - 3, "end", number(bounds[0][1])),
      text(width / 2, height - 3, "middle", `feature ${a}`), text(1.5, margin - 2, "start", `feature ${b}: ${number(bounds[1][0])} to ${number(bounds[1][1])}`),
      ...this.cloud(visits.map(to)),
      ...this.scene(to, 0.9, 6),
    ];
    say(this.scale, visits.length ? `Visits: every ${count(this.head.states_every)}th of the agent's newest states, older ones fainter` : "");
    this.put(`0 0 ${width} ${height}`, parts, null, width / height);
  }

  // Size of letters in a picture that is 100 wide: 12 pixels.
  letter() {
    return near(Math.min(5, Math.max(2.4, 1200 / (this.stage.clientWidth || 480))));
  }

  // States as dots, the newest last, in four groups by their age.
  cloud(places) {
    const size = Math.ceil(places.length / 4);
    return [0, 1, 2, 3].map((group) => {
      const dots = places.slice(group * size, (group + 1) * size).map(([x, y]) => `M${near(x)} ${near(y)}h0`);
      return dots.length ? h("path", { class: "visit", d: dots.join(""), opacity: 0.25 + 0.2 * group }) : null;
    });
  }

  // How often each of the mentor's steps was met since a quarter of the moments ago.
  met() {
    const before = this.moments[Math.max(0, Math.floor(0.75 * this.at))] ?? {};
    const [now, then] = [this.now, before === this.now ? {} : before].map((moment) => array(moment.visited).map(Number));
    const met = this.from.map((_, step) => Math.max(0, (now[step] || 0) - (then[step] || 0)));
    return { met, most: Math.max(...met, 0), since: before === this.now ? 0 : Number(before.env_steps) || 0 };
  }

  // Along the mentor's steps, with visits behind them and bridges below: e_KL upwards, logarithmic, or where the path is only led along
  // the probability of the likeliest action.
  drawTime() {
    const letter = this.letter();
    const [width, height, margin, floor] = [100, 56, Math.max(8, 3.4 * letter), 38];
    const led = !!this.head.mentor.led;
    const known = (list) => this.from.map((_, step) => array(list)[step]).map((x) => (x === null || x === undefined ? NaN : Number(x)));
    const errors = led ? known(this.now.sure) : known(this.now.e_kl).map((x) => Math.max(x, 1e-6));
    const finite = errors.filter(Number.isFinite);
    const [low, high] = led ? [0, 1] : [Math.floor(Math.log10(Math.min(...finite, 1))), Math.ceil(Math.log10(Math.max(...finite, 1)) + 0.01)];
    const x = (step) => margin + ((step + 0.5) / this.from.length) * (width - 2 * margin);
    const scaled = (value) => floor - (((led ? value : Math.log10(value)) - low) / (high - low || 1)) * (floor - 5);
    const y = (value) => (Number.isFinite(value) ? scaled(value) : led ? floor : 3);
    const parts = [h("path", { class: "axis", d: `M${margin} 3V${floor}H${width - margin}` })];
    const { met, most, since } = this.met();
    if (this.shown.visits && most > 0) {
      const half = (0.5 * (width - 2 * margin)) / this.from.length;
      const bars = met.map((visits, step) => `M${near(x(step) - half)} ${floor}v${near(-(floor - 5) * Math.sqrt(visits / most))}h${near(2 * half)}V${floor}Z`);
      parts.push(h("path", { class: "bars", d: bars.join("") }));
    }
    const tick = (value, words) => parts.push(h("text", { class: "tick", x: margin - 1, y: near(y(value) + 0.35 * letter), "font-size": letter, "text-anchor": "end" }, words));
    if (led) [0, 0.5, 1].forEach((value) => tick(value, percent(value)));
    else for (let power = low; power <= high; power += Math.max(1, Math.ceil((high - low) / 4))) tick(10 ** power, power === 0 ? "1" : `1e${power}`);
    parts.push(h("text", { class: "tick", x: margin + 1, y: letter, "font-size": letter }, led ? "probability of the likeliest action" : "e_KL"),
      h("text", { class: "tick", x: width / 2, y: height - 1, "font-size": letter, "text-anchor": "middle" }, led ? "the mentor's steps" : "the mentor's steps, and bridges by where they lead"));
    this.places = errors.map((error, step) => [near(x(step)), near(y(error))]);
    const r = Math.min(0.9, (0.35 * (width - 2 * margin)) / this.from.length);
    this.from.forEach((_, step) => {
      const [a, b] = this.places[step];
      parts.push(h("path", { class: `stem k-${this.kind(step)}`, d: `M${a} ${floor}V${b}` }));
    });
    this.places.forEach(([a, b], step) => parts.push(mark(this.kind(step), a, b, near(r))));
    if (this.shown.bridges) {
      this.from.forEach((_, step) => {
        if (this.kind(step) !== "b") return;
        const ahead = Number(array(this.now.ahead)[step]) || Number(array(this.now.bridge)[step]) || 1;
        const [from, to] = [x(step), x(Math.min(step + ahead / this.stride, this.from.length - 0.5))];
        parts.push(h("path", { class: step === this.picked ? "arc picked" : "arc", "stroke-width": 1.8, d: `M${near(from)} ${floor + 1}Q${near((from + to) / 2)} ${near(floor + 3 + Math.min(14, 0.9 * (to - from)))} ${near(to)} ${floor + 1}` }));
      });
    }
    const place = this.places[this.picked];
    if (place) parts.push(h("circle", { class: "pick", cx: place[0], cy: place[1], r: 1.8 }));
    say(this.scale, this.shown.visits && most > 0 ? `Visits: bars, ${led ? "the agent's steps near each step" : "transitions that each step was picked for"} since step ${count(since)}, ${count(most)} at most` : "");
    this.put(`0 0 ${width} ${height}`, parts, null, width / height);
  }

  put(viewBox, parts, canvas, ratio) {
    const label = !this.from.length ? "Map" : `${this.title.textContent}: of ${this.from.length} mentor steps ${this.kinds.map(([kind, name]) => `${this[`n${kind}`]?.textContent} ${name}`).join(", ")}`;
    const svg = h("svg", { viewBox, role: "img", "aria-label": label, preserveAspectRatio: "xMidYMid meet" }, parts);
    this.stage.style.maxWidth = `min(100%, ${Math.round(Math.max(320, 620 * ratio))}px)`;
    this.stage.replaceChildren(...(canvas ? [canvas] : []), svg);
  }

  drawStep() {
    const step = this.picked;
    show(this.step, step !== null && this.from.length > 0);
    if (step === null || !this.from.length) return;
    const now = this.now;
    const cell = (list) => Number(array(list)[step]);
    const kind = this.kinds.find(([letter]) => letter === this.kind(step)) ?? KINDS[3];
    say(this.stepNow, `${step * this.stride} of ${count(this.head.mentor?.transitions)}`);
    const action = array(this.head.actions)[cell(now.action)];
    const error = array(now.e_kl)[step];
    const span = cell(now.bridge);
    const led = !!this.head.mentor?.led;
    const facts = led ? [
      ["State", kind[1]],
      ["Agent near", `${count(cell(now.visited))} steps`],
      ["Led by", action ?? "–"],
      ["Probability", percent(cell(now.sure))],
    ] : [
      ["State", kind[1]],
      ["a_est", action ?? "none yet"],
      ["e_KL", error === null || error === undefined ? "none yet" : Number(error).toPrecision(3)],
      ["Picked for", `${count(cell(now.visited))} transitions`],
      ["Used", `${count(cell(now.used))} samples`],
      ["Bridge", span > 0 ? `${span} step${span > 1 ? "s" : ""}${cell(now.ahead) ? `, to ${cell(now.ahead)} ahead` : ""}` : "none"],
      ...(span > 0 ? [["Bridge age", `${count(now.env_steps - cell(now.found))} steps`]] : []),
    ];
    this.stepFacts.replaceChildren(...facts.flatMap(([term, text]) => [h("dt", {}, term), h("dd", {}, text)]));
    const key = led ? "sure" : "e_kl";
    const known = this.moments.filter((moment) => Number.isFinite(array(moment[key])[step]));
    this.history.set([{
      label: led ? "probability" : "e_KL", color: "c0", x: known.map((moment) => Number(moment.env_steps)), y: known.map((moment) => Math.max(Number(moment[key][step]), 1e-6)),
    }], "environment steps");
  }
}

