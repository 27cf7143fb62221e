"use strict";
// The missions of a live view: their graphs, activities, timelines and processes. Texts of robots become text nodes. The pictures
// come from the view itself, as SVG whose texts are escaped.
const byId = (id) => document.getElementById(id);
// Each order and each question repeats it.
const token = document.querySelector("meta[name=dca-token]").content;
const model = { robots: new Map(), deployments: new Map(), processes: new Map(), wires: new Map(), events: [], questions: [] };
const INDENT = 16;
// Each mark has a sign, so that no state is told by colour alone.
const SIGNS = { running: "▶", idle: "○", changing: "↻", done: "✓", stopped: "■", failed: "✕", lost: "?" };
// The letters of a state that fit into its box.
const STATE_MAX = 17;
// Seconds between two timelines of one mission, and after a failed attempt to fetch a picture.
const TIMELINE_EVERY = 2;
const AGAIN_AFTER = 3;
// Milliseconds for a picture.
const DRAWN_WITHIN = 10000;
// One picture is fetched at a time: a browser has few connections for a host, and an order must not wait for them.
let isFetching = false;

function element(name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

function age(seconds) {
  if (seconds === null || seconds === undefined) return "";
  if (seconds < 120) return `${Math.floor(seconds)} s`;
  if (seconds < 7200) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}

const now = () => performance.now() / 1000;
const since = (item) => (item.at === null ? null : now() - item.at);

function phase(live) {
  const time = since(live);
  if (time === null) return live.phase;
  return live.ended ? `${live.phase}, ${age(time)} ago` : `${live.phase} for ${age(time)}`;
}

// A part of a mission that is fetched when it is opened: a picture in a box that scrolls.
class Drawing {
  constructor(title, label, show) {
    this.show = show;
    this.root = element("details", "drawing");
    this.summary = element("summary", "", title);
    this.box = element("div", "wide");
    this.box.tabIndex = 0;
    this.box.setAttribute("role", "region");
    this.box.setAttribute("aria-label", label);
    this.note = element("p", "quiet");
    this.root.append(this.summary, this.box, this.note);
    this.shown = null;
    this.data = null;
    this.loaded = 0;
    this.of = null;
    this.notBefore = 0;
  }

  // Fetches what stands at an address, unless it is shown already. `live` is the mission as it is now.
  async load(address, isFresh, live) {
    if (!this.root.open || isFetching || now() < this.notBefore || (this.shown === address && !isFresh)) return;
    isFetching = true;
    try {
      const answer = await fetch(address, { signal: AbortSignal.timeout(DRAWN_WITHIN) });
      if (!answer.ok) throw new Error(answer.statusText);
      this.data = await answer.json();
      this.shown = address;
      this.put();
      this.loaded = now();
      this.of = live;
    } catch (error) {
      this.notBefore = now() + AGAIN_AFTER;
      this.note.textContent = `no picture: ${error.message}`;
    }
    isFetching = false;
  }

  put() {
    const made = this.data.svg ? new DOMParser().parseFromString(this.data.svg, "image/svg+xml").documentElement : null;
    const isSvg = made !== null && made.localName === "svg" && made.querySelector("parsererror") === null;
    this.box.hidden = !isSvg;
    this.note.textContent = this.data.why ?? (isSvg ? this.data.note ?? "" : "no picture: it cannot be read");
    this.box.replaceChildren(...(isSvg ? [document.importNode(made, true)] : []));
    this.show(this);
  }
}

function own(unit, name) {
  return [...unit.children].find((child) => child.matches(name));
}

// Shows a box in its state. `title` is what stands in the box anyway.
function mark(unit, word, text) {
  const classes = word ? `unit ${word}` : "unit";
  const shown = word ? `${SIGNS[word]} ${text.length > STATE_MAX ? `${text.slice(0, STATE_MAX - 1)}…` : text}` : "";
  const state = own(unit, "text.state");
  if (unit.getAttribute("class") === classes && state.textContent === shown) return;
  unit.setAttribute("class", classes);
  state.textContent = shown;
  const title = own(unit, "title");
  unit.dataset.title ??= title.textContent;
  title.textContent = word ? `${unit.dataset.title}: ${text}` : unit.dataset.title;
}

function colourGraph(live, drawing) {
  for (const unit of drawing.box.querySelectorAll("g.unit")) {
    const process = model.processes.get(`${live.id}:${unit.dataset.key}`) ?? live.ends[unit.dataset.key];
    mark(unit, process?.mark, process?.text ?? "");
  }
  for (const part of drawing.box.querySelectorAll("[data-wires]")) {
    let lost = 0, lostASecond = 0, refused = 0;
    for (const number of part.dataset.wires.split(" ")) {
      const wire = model.wires.get(`${live.id}:${drawing.data.wires?.[number]}`);
      lost += wire?.lost ?? 0;
      lostASecond += wire?.lostASecond ?? 0;
      refused += wire?.refused ?? 0;
    }
    part.classList.toggle("losing", lostASecond > 0);
    part.classList.toggle("lossy", lost + refused > 0);
    if (part.localName !== "text") continue;
    const words = [lostASecond > 0 ? `✕ ${lostASecond.toFixed(1)}/s lost` : lost ? `✕ ${lost} lost` : "", refused ? `⊘ ${refused} refused` : ""];
    part.textContent = words.filter((word) => word).join(", ");
  }
}

function colourStates(live, path, drawing) {
  const states = model.processes.get(`${live.id}:${path}`)?.states ?? [];
  const active = new Set();
  for (const unit of drawing.box.querySelectorAll("g.unit")) {
    if (!states.includes(unit.dataset.key)) continue;
    for (let at = unit; at; at = at.parentElement.closest("g.unit")) active.add(at);
  }
  for (const unit of drawing.box.querySelectorAll("g.unit")) mark(unit, active.has(unit) ? "running" : undefined, "active");
}

// The parts of a mission, which stay where they are: a person may scroll in them.
const cards = new Map();

class Card {
  constructor(live) {
    this.root = element("article");
    this.title = element("h3");
    this.phase = element("span");
    this.title.append(`${live.title}, home ${live.home}  `, this.phase);
    this.graph = new Drawing("Graph", `graph of ${live.title}`, (drawing) => this.shown(drawing));
    this.graph.root.open = !live.ended || live.failed;
    this.key = element("p", "key quiet");
    for (const [word, sign] of Object.entries(SIGNS)) this.key.append(element("span", word, `${sign} ${word}`));
    this.graph.root.append(this.key);
    this.activities = new Map();
    this.place = element("div");
    this.timeline = new Drawing("Timeline", `timeline of ${live.title}`, () => {});
    this.window = element("select");
    for (const [value, text] of [["", "everything"], ["-60", "the last minute"], ["-600", "the last 10 minutes"]]) {
      const option = element("option", "", text);
      option.value = value;
      this.window.append(option);
    }
    this.window.addEventListener("change", () => this.fetch(model.deployments.get(this.id)));
    const choice = element("label", "", "Show ");
    choice.append(this.window);
    this.timeline.summary.after(choice);
    this.table = element("table", "tree");
    this.root.append(this.title, this.graph.root, this.place, this.timeline.root, this.table);
    this.id = live.id;
    for (const drawing of [this.graph, this.timeline]) this.follow(drawing);
  }

  // Fetches a part as soon as it is opened.
  follow(drawing) {
    drawing.root.addEventListener("toggle", () => this.fetch(model.deployments.get(this.id)));
  }

  // Makes a part for each activity once the graph has told them.
  shown(drawing) {
    const told = drawing.data.activities ?? [];
    for (const { group, path } of told) {
      if (this.activities.has(path)) continue;
      const states = new Drawing("", `states of ${path}`, () => this.draw(model.deployments.get(this.id)));
      this.follow(states);
      this.activities.set(path, states);
      this.place.append(states.root);
    }
    for (const [path, states] of this.activities) {
      states.group = told.find((one) => one.path === path)?.group;
      states.root.hidden = states.group === undefined;
    }
    this.draw(model.deployments.get(this.id));
  }

  draw(live) {
    if (live === undefined) return;
    this.phase.textContent = phase(live);
    this.phase.className = live.failed ? "failed" : "quiet";
    const hasPlan = live.plan !== null;
    for (const drawing of [this.graph, this.timeline]) drawing.root.hidden = !hasPlan;
    if (this.graph.data) colourGraph(live, this.graph);
    for (const [path, states] of this.activities) {
      const named = model.processes.get(`${live.id}:${path}`)?.states ?? [];
      states.summary.textContent = `States of ${path}${named.length ? `: ${named.join(", ")}` : ""}`;
      if (states.data) colourStates(live, path, states);
    }
    this.processes(live);
  }

  // Fetches the parts that are open and lack a picture, and the timeline again while time passes. A mission that has ended is another
  // object once it has changed, so its timeline is fetched until it shows this object.
  fetch(live) {
    if (live === undefined || live.plan === null || document.hidden) return;
    this.graph.load(`/picture?${live.plan}`);
    for (const states of this.activities.values()) {
      if (states.group !== undefined) states.load(`/picture?${live.plan}-${states.group}`);
    }
    const isOld = !live.ended || this.timeline.of !== live;
    const address = `/timeline?${live.plan}${this.window.value}`;
    this.timeline.load(address, isOld && now() - this.timeline.loaded > TIMELINE_EVERY, live);
  }

  processes(live) {
    const rows = [];
    const processes = [...model.processes.values()].filter((one) => one.mission === live.id).sort((a, b) => (a.path < b.path ? -1 : 1));
    if (processes.length > 0) {
      const head = element("tr");
      for (const [title, kind] of [["process", ""], ["state", ""], ["since", "number"], ["host", ""], ["pid", "number spare"]]) head.append(element("th", kind, title));
      rows.push(head);
    }
    for (const process of processes) {
      const row = element("tr");
      const depth = process.path.split("/").length - 1;
      const name = element("td", "", `${process.path.split("/").pop()}: ${process.kind}`);
      // The policy forbids styles in the page, and permits them from its script.
      name.style.paddingLeft = `${depth * INDENT}px`;
      // Without an event that tells the moment, it was then or before.
      const began = (process.exact ? "" : ">") + age(since(process));
      const restarts = process.restarts ? `, restarted ${process.restarts} times` : "";
      row.append(name, element("td", process.health, process.state + restarts), element("td", "number", began), element("td", "", process.host), element("td", "number spare", process.pid ?? ""));
      rows.push(row);
    }
    this.table.replaceChildren(...rows);
  }
}

function drawMissions() {
  for (const id of cards.keys()) if (!model.deployments.has(id)) cards.delete(id);
  const lives = [...model.deployments.values()].sort((a, b) => (a.id < b.id ? -1 : 1));
  for (const live of lives) {
    if (!cards.has(live.id)) cards.set(live.id, new Card(live));
    cards.get(live.id).draw(live);
  }
  const wanted = lives.length ? lives.map((live) => cards.get(live.id).root) : [element("p", "quiet", "nothing is deployed")];
  const place = byId("deployments");
  // A node that is put in again loses its focus and where it was scrolled to.
  const isSame = lives.length > 0 && wanted.length === place.children.length && wanted.every((one, index) => one === place.children[index]);
  if (!isSame) place.replaceChildren(...wanted);
  fetchPictures();
}

function fetchPictures() {
  for (const [id, card] of cards) card.fetch(model.deployments.get(id));
}
