// The page: one stream of states from the server, and the view that fits what they are about.

import { address, h, say, show } from "./dom.js";
import { FolderView } from "./folder.js";
import { RunView } from "./run.js";

const main = document.getElementById("main");
const link = document.getElementById("link");
const below = location.pathname.startsWith("/run/") ? decodeURIComponent(location.pathname.slice(5)) : "";

function crumbs() {
  const names = below.split("/").filter(Boolean);
  const parts = [h("a", { href: "/" }, "All runs")];
  names.forEach((name, at) => {
    const here = names.slice(0, at + 1).join("/");
    parts.push(h("span", { "aria-hidden": "true" }, "/"), at + 1 < names.length ? h("a", { href: address("run", here) }, name) : h("span", { "aria-current": "page" }, name));
  });
  document.getElementById("crumbs").replaceChildren(...(names.length ? parts : []));
}

// What there is before there is anything.
class MissingView {
  constructor() {
    this.path = h("code", {});
    this.fault = h("p", {});
    this.element = h("section", { class: "card hero" },
      h("svg", { viewBox: "0 0 32 32", "aria-hidden": "true" }, h("path", { d: "M2 9h28M7 9 3 25M7 9l4 16M16 9l-5 16M16 9l5 16M25 9l-4 16M25 9l4 16" })),
      h("h1", {}, "Nothing here yet"),
      h("p", {}, "The page comes up by itself as soon as there is something at ", this.path, "."), this.fault);
  }

  update(state) {
    say(this.path, state.path);
    say(this.fault, state.fault ?? "");
    document.title = "Nothing yet – Trestle";
  }
}

const VIEWS = { run: RunView, folder: FolderView, missing: MissingView };
const banner = h("p", { class: "note hidden", role: "alert" });
let view = null;
let kind = null;

function render(state) {
  if (!state || !VIEWS[state.kind]) return;
  // What has been seen stays to be read when its folder goes.
  const gone = state.kind === "missing" && (kind === "run" || kind === "folder");
  show(banner, gone);
  if (gone) {
    say(banner, `${state.path} is gone. This is what was there last.`);
    return;
  }
  if (state.kind !== kind) {
    kind = state.kind;
    view = new VIEWS[kind](below);
    main.replaceChildren(banner, view.element);
  }
  view.update(state);
}

function connect() {
  const source = new EventSource(address("events", below));
  const tell = (text, style) => { say(link, text); link.className = `link ${style}`; };
  source.onopen = () => tell("live", "on");
  source.onmessage = (event) => {
    tell("live", "on");
    render(JSON.parse(event.data));
  };
  source.onerror = () => {
    tell("no connection; trestle watch has ended?", "off");
    if (source.readyState === EventSource.CLOSED) {
      source.close();
      setTimeout(connect, 3000);
    }
  };
}

crumbs();
connect();
