// The page: one stream of states from the server, and the view that fits what they are about.

import { address, h, say, show } from "./dom.js";
import { FolderView } from "./folder.js";
import { RunView } from "./run.js";

const main = document.getElementById("main");
const link = document.getElementById("link");
const below = location.pathname.startsWith("/run/") ? decoded(location.pathname.slice(5)) : "";

// An address that says no text stays as it was typed.
function decoded(path) {
  try {
    return decodeURIComponent(path);
  } catch {
    return path;
  }
}

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

// Browsers allow a handful of connections to one server: a page that nobody sees gives its stream back, and asks now and then, so
// that its title stays true.
const HIDDEN_MS = 5000;
let source = null;
let timer = null;

function tell(text, style) {
  say(link, text);
  link.className = `link ${style}`;
}

function later(what, ms) {
  clearTimeout(timer);
  timer = setTimeout(what, ms);
}

function connect() {
  source?.close();
  clearTimeout(timer);
  if (document.hidden) {
    ask();
    return;
  }
  source = new EventSource(address("events", below));
  source.onopen = () => tell("live", "on");
  source.onmessage = (event) => {
    tell("live", "on");
    render(JSON.parse(event.data));
  };
  source.onerror = () => {
    tell("no connection; has trestle watch ended?", "off");
    // An answer that is no stream says why; without an answer the browser itself tries again.
    if (source.readyState === EventSource.CLOSED) {
      why();
      later(connect, 3000);
    }
  };
}

async function ask() {
  try {
    render(await (await fetch(address("state", below))).json());
  } catch {
    // The next time tells.
  }
  if (document.hidden) later(ask, HIDDEN_MS);
}

async function why() {
  try {
    const end = new AbortController();
    const answer = await fetch(address("events", below), { signal: end.signal });
    if (!answer.ok) {
      const text = await answer.text();
      tell(text, "off");
      if (!view) main.replaceChildren(h("section", { class: "card hero" }, h("h1", {}, text)));
    }
    end.abort();
  } catch {
    // There is no server to say it.
  }
}

document.addEventListener("visibilitychange", connect);
crumbs();
connect();
