// Lines over an axis, by uPlot, with a legend of our own that says the number under the pointer.

import { color, h, number, say } from "./dom.js";

const DASHES = [[], [8, 4], [3, 3], [12, 4, 3, 4]];
const all = new Set();

// What may be plotted over, and how it is called.
export const AXES = [["episode", "episodes"], ["env_steps", "steps"], ["wall_s", "minutes"]];
export const axisLabel = { episode: "episodes", env_steps: "environment steps", wall_s: "minutes of training" };
export const onAxis = (axis, xs) => (axis === "wall_s" ? (xs ?? []).map((x) => x / 60) : xs ?? []);

export const short = (x) => {
  const size = Math.abs(x);
  if (size >= 1e6) return `${Number((x / 1e6).toPrecision(4))} M`;
  if (size >= 1e4) return `${Number((x / 1e3).toPrecision(4))} k`;
  return number(x);
};

// The line of a legend: color and dashes as in the chart.
function swatch(line) {
  return h("svg", { viewBox: "0 0 24 10", "aria-hidden": "true" }, h("line", {
    x1: 1, x2: 23, y1: 5, y2: 5, "stroke-width": line.width ?? 2, "stroke-dasharray": (line.dash ?? []).join(" ") || null,
    stroke: `var(--${line.color})`, "stroke-linecap": "round",
  }));
}

// Without points nothing would be seen of a line that has one.
const few = (line) => line.y.filter((y) => y !== null && y !== undefined).length < 3;

// `lines`: {label, color, width, dash, points, x, y, low, high}: a line with its own x, and a band around it where there is one.
export class Chart {
  constructor({ label, height = 220, y = "", log = false, range = null, format = number }) {
    this.settings = { label, height, y, log, range, format };
    this.box = h("div", { class: "chart", role: "img", "aria-label": label });
    this.legend = h("ul", { class: "legend" });
    this.none = h("p", { class: "empty hidden" }, "Nothing recorded");
    this.element = h("div", { class: "stack tight" }, this.box, this.none, this.legend);
    this.shape = "";
    new ResizeObserver(() => this.resize()).observe(this.box);
    all.add(this);
  }

  set(lines, xLabel) {
    this.lines = lines.filter((line) => line.x.length > 0);
    this.xLabel = xLabel;
    this.none.classList.toggle("hidden", this.lines.length > 0);
    this.box.classList.toggle("hidden", this.lines.length === 0);
    if (!this.lines.length) return this.legend.replaceChildren();
    const columns = [];
    this.places = this.lines.map((line) => {
      const place = columns.length;
      columns.push([line.x, line.y]);
      if (line.low) columns.push([line.x, line.high], [line.x, line.low]);
      return place;
    });
    this.data = columns.length === 1 ? columns[0] : window.uPlot.join(columns);
    const shape = JSON.stringify([xLabel, this.lines.map((line) => [line.label, line.color, line.dash, !!line.low, !!line.points, few(line)])]);
    if (shape !== this.shape || !this.plot) {
      this.shape = shape;
      this.build();
    } else {
      // A part that somebody has enlarged stays while new points come.
      const { scales: { x: { min, max } }, data: [xs] } = this.plot;
      const part = min > xs[0] || max < xs.at(-1);
      this.plot.setData(this.data, !part);
      if (part) this.plot.setScale("x", { min, max });
    }
    this.tell(this.plot.cursor.idx);
  }

  build() {
    this.plot?.destroy();
    const { height, y, log, range, format } = this.settings;
    const [ink, grid] = [color("soft"), color("line")];
    const series = [{}];
    const bands = [];
    for (const line of this.lines) {
      const stroke = color(line.color);
      series.push({
        label: line.label, stroke, width: line.width ?? 2, dash: line.dash, spanGaps: true,
        points: { show: !line.constant && (!!line.points || few(line)), size: 5, fill: stroke },
      });
      if (line.low) {
        const hidden = { stroke: "transparent", width: 0, spanGaps: true, points: { show: false } };
        bands.push({ series: [series.length, series.length + 1], fill: `${stroke}2e` });
        series.push(hidden, { ...hidden });
      }
    }
    const font = "12px system-ui, sans-serif";
    const axis = { stroke: ink, font, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, labelFont: font, labelSize: 16, labelGap: 0, gap: 4 };
    this.plot = new window.uPlot({
      width: Math.max(this.box.clientWidth, 200), height, bands, series, pxAlign: 1,
      cursor: { y: false, points: { size: 7 }, drag: { x: true, y: false } },
      legend: { show: false },
      scales: { x: { time: false }, y: { distr: log ? 3 : 1, range: range ?? undefined } },
      axes: [
        { ...axis, label: this.xLabel || null, size: 28, values: (_, ticks) => ticks.map(short), space: 70 },
        { ...axis, label: y || null, size: 54, ...(log ? { grid: { show: false } } : {}), values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : format(tick))) },
      ],
      hooks: { setCursor: [(plot) => this.tell(plot.cursor.idx)] },
    }, this.data, this.box);
    this.entries = this.lines.map((line) => {
      const output = h("output", {});
      return [h("li", {}, swatch(line), h("span", {}, line.label), output), output];
    });
    this.legend.replaceChildren(...this.entries.map(([entry]) => entry));
  }

  // The numbers under the pointer, or the newest ones.
  tell(index) {
    const said = [];
    this.lines.forEach((line, at) => {
      const column = this.data[this.places[at] + 1];
      let place = index ?? column.length - 1;
      while (place >= 0 && (column[place] === null || column[place] === undefined)) place -= 1;
      const value = place >= 0 ? this.settings.format(column[place]) : "";
      say(this.entries[at][1], line.constant ? this.settings.format(line.y[0]) : value);
      said.push(`${line.label} ${value}`);
    });
    if (index === null || index === undefined) this.box.setAttribute("aria-label", `${this.settings.label}: ${said.join(", ")}`);
  }

  resize() {
    const width = this.box.clientWidth;
    if (this.plot && width > 0 && width !== this.plot.width) this.plot.setSize({ width, height: this.settings.height });
  }
}

export const dash = (index) => DASHES[Math.floor(index / 6) % DASHES.length];

// The colours of a light or dark screen are drawn, not styled.
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const chart of all) if (chart.plot) chart.build();
});
