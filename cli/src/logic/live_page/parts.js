"use strict";
// The parts of a live view that ask robots, and only while they are open. Texts of robots become text nodes.

// The lines of output that are kept.
const LINES_MAX = 500;

// A folded part. `body` returns what it asks for, or nothing while it needs nothing. `show` gets the answer.
class Part {
  constructor(id, path, every) {
    this.root = byId(id);
    this.path = path;
    this.every = every;
    this.note = this.root.querySelector("p");
    this.list = this.root.querySelector("ul");
    this.loaded = -Infinity;
    this.notBefore = 0;
    this.root.addEventListener("toggle", () => this.again());
  }

  // Asks again as soon as possible.
  again() {
    this.loaded = -Infinity;
    this.fetch();
  }

  async fetch() {
    if (!this.root.open || document.hidden || isFetching || now() < this.notBefore || now() - this.loaded < this.every) return;
    const body = this.body();
    if (body === null) return;
    isFetching = true;
    const asked = now();
    try {
      const headers = { "X-Dca-Token": token, "Content-Type": "application/json" };
      const answer = await fetch(this.path, { method: "POST", headers, body: JSON.stringify(body), signal: AbortSignal.timeout(DRAWN_WITHIN) });
      if (!answer.ok) throw new Error(answer.statusText);
      const data = await answer.json();
      // A person may have chosen something else in the meantime.
      if (JSON.stringify(body) === JSON.stringify(this.body())) {
        this.loaded = Math.max(this.loaded, asked);
        this.show(data);
      }
    } catch (error) {
      this.notBefore = now() + AGAIN_AFTER;
      this.drawn = undefined;
      this.note.textContent = `no answer: ${error.message}`;
    }
    isFetching = false;
  }
}

// The parameters of programs. A row stays while a person types in it.
class ParametersPart extends Part {
  constructor() {
    super("parameters", "/parameters", 3);
    this.rows = new Map();
    this.filter = this.root.querySelector("input");
    this.filter.addEventListener("input", () => this.sift());
  }

  body() {
    return {};
  }

  show(data) {
    const keys = new Set();
    for (const one of data.parameters) {
      const key = JSON.stringify([one.robot, one.deployment, one.instance, one.parameter]);
      keys.add(key);
      if (!this.rows.has(key)) this.rows.set(key, this.row(one));
      const row = this.rows.get(key);
      const written = (value) => (value === null ? "no value" : `${typeof value === "string" ? value : JSON.stringify(value)}${one.unit ? ` ${one.unit}` : ""}`);
      row.value.textContent = written(one.value);
      const isChanged = JSON.stringify(one.value) !== JSON.stringify(one.spec);
      row.spec.textContent = `${isChanged ? `the spec has ${written(one.spec)}; ` : ""}takes ${one.takes}`;
      row.undo.hidden = !isChanged;
    }
    for (const key of this.rows.keys()) if (!keys.has(key)) this.rows.delete(key);
    const wanted = [...this.rows.values()].map((row) => row.root);
    const isSame = wanted.length === this.list.children.length && wanted.every((one, index) => one === this.list.children[index]);
    if (!isSame) this.list.replaceChildren(...wanted);
    this.note.textContent = [...(wanted.length ? [] : ["no program that runs has parameters"]), ...data.notes].join("; ");
    this.sift();
  }

  sift() {
    const filter = this.filter.value.toLowerCase();
    for (const row of this.rows.values()) row.root.hidden = !row.name.toLowerCase().includes(filter);
  }

  row(one) {
    const name = `${one.deployment}:${one.instance}.${one.parameter}`;
    const row = { root: element("li", "parameter"), name, value: element("b"), spec: element("small", "quiet"), undo: element("button", "", "Undo") };
    const form = element("form"), input = element("input"), set = element("button", "", "Set");
    input.autocomplete = "off";
    input.setAttribute("aria-label", `new value of ${name}`);
    set.setAttribute("aria-label", `set ${name}`);
    row.undo.type = "button";
    row.undo.setAttribute("aria-label", `undo the change of ${name}`);
    const change = async (value) => {
      await order("/parameter", { robot: one.robot, name, value });
      this.again();
    };
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (input.value.trim() !== "") change(input.value).then(() => (input.value = ""));
    });
    row.undo.addEventListener("click", () => change(null));
    form.append(input, set, row.undo);
    const words = element("div");
    words.append(`${name} on ${one.robot} `, row.value, row.spec);
    row.root.append(words, form);
    return row;
  }
}

// The keys of a robot below a prefix, or one key with its history and its conflicts.
class DatabasePart extends Part {
  constructor() {
    super("database", "/database", 5);
    this.robot = this.root.querySelector("select");
    this.key = this.root.querySelector("input");
    this.details = this.root.querySelector(".details");
    this.robot.addEventListener("change", () => this.again());
    this.key.addEventListener("input", () => this.again());
  }

  // Clears the answer, which is for another key, and asks.
  again() {
    this.drawn = undefined;
    this.list.replaceChildren();
    this.details.replaceChildren();
    this.note.textContent = this.root.open ? "reading …" : "";
    super.again();
  }

  fetch() {
    this.offer();
    return super.fetch();
  }

  body() {
    return this.robot.value === "" ? null : { robot: this.robot.value, key: this.key.value.trim() };
  }

  // Offers the robots.
  offer() {
    const robots = [...model.robots.keys()].sort();
    const shown = [...this.robot.options].map((option) => option.value);
    if (JSON.stringify(robots) === JSON.stringify(shown)) return;
    const chosen = this.robot.value;
    this.robot.replaceChildren(...robots.map((robot) => new Option(robot, robot, false, robot === chosen)));
  }

  show(data) {
    const text = JSON.stringify([data, this.body()]);
    // A button that is being pressed stays the same button.
    if (text === this.drawn) return;
    this.drawn = text;
    const keys = data.keys ?? [];
    this.note.textContent = data.why ?? (data.keys && keys.length === 0 ? "there are no keys below this prefix" : data.note ?? "");
    this.list.replaceChildren(...keys.map((one) => this.row(one)));
    this.details.replaceChildren(...(data.keys || data.why ? [] : this.one(data)));
  }

  row(one) {
    const row = element("li"), button = element("button", "key-name", one.key);
    button.type = "button";
    button.addEventListener("click", () => {
      this.key.value = one.key;
      this.key.focus();
      this.again();
    });
    row.append(button, ` ${one.value}`);
    if (one.writes > 1) row.append(element("span", "changing", ` ${one.writes} concurrent writes`));
    return row;
  }

  one(data) {
    const back = element("button", "", "Back to the list");
    back.type = "button";
    back.addEventListener("click", () => {
      const parts = this.key.value.trim().split("/");
      this.key.value = parts.length > 1 ? `${parts.slice(0, -1).join("/")}/` : "";
      this.key.focus();
      this.again();
    });
    const made = [back, element("p", "value", data.value === null ? "there is nothing at this key" : data.value)];
    if (data.is_default) made.push(element("p", "quiet", "nothing is stored at this key; its schema has this default"));
    for (const [title, text, none] of [["History", data.history, "the log has no changes of this key"], ["Conflicts", data.conflicts, "no conflicts"]]) {
      made.push(element("h3", "", title));
      if (text === null) {
        made.push(element("p", "quiet", none));
        continue;
      }
      const box = element("pre", "wide", text);
      box.tabIndex = 0;
      box.setAttribute("role", "region");
      box.setAttribute("aria-label", title);
      made.push(box);
    }
    return made;
  }
}

// The output of one process. It comes with the stream of changes, which is opened again for another choice.
class OutputPart {
  constructor() {
    this.root = byId("output");
    this.choice = this.root.querySelector("select");
    this.note = this.root.querySelector("p");
    this.box = this.root.querySelector("pre");
    this.lines = [];
    this.following = "";
    // The programs of the missions that are shown, with those that have ended.
    this.programs = new Map();
    this.root.addEventListener("toggle", () => this.fetch());
    this.choice.addEventListener("change", () => this.fetch());
  }

  // Returns the process whose output is shown, as the address of the stream has it.
  query() {
    return this.root.open && this.choice.value ? `&output=${this.choice.value}` : "";
  }

  fetch() {
    this.offer();
    const query = this.query();
    if (query === this.following) return;
    this.following = query;
    this.clear(query ? "it has written nothing yet" : "");
    reopen();
  }

  // Offers the programs that run, and those that have ended: their last lines say why.
  offer() {
    for (const process of model.processes.values()) {
      const live = model.deployments.get(process.mission);
      if ((process.pid || process.restarts) && live && live.plan !== null)
        this.programs.set(`${live.plan}-${process.path}`, { mission: process.mission, text: `${live.title}: ${process.path}` });
    }
    for (const [value, program] of this.programs) if (!model.deployments.has(program.mission)) this.programs.delete(value);
    const programs = [...this.programs].map(([value, program]) => [value, program.text]);
    programs.sort((a, b) => (a[1] < b[1] ? -1 : 1));
    const wanted = [["", programs.length ? "choose a process" : "no program has run"], ...programs];
    const shown = [...this.choice.options].map((option) => [option.value, option.text]);
    if (JSON.stringify(wanted) === JSON.stringify(shown)) return;
    const value = this.choice.value;
    this.choice.replaceChildren(...wanted.map(([one, text]) => new Option(text, one, false, one === value)));
  }

  clear(note) {
    this.lines = [];
    this.box.textContent = "";
    this.box.hidden = true;
    this.note.textContent = note;
  }

  take(news) {
    if (news.begins) this.clear("");
    if (news.leftOut) this.lines.push(`… ${news.leftOut} lines are not shown here …`);
    this.lines.push(...news.lines);
    this.lines.splice(0, Math.max(0, this.lines.length - LINES_MAX));
    const { scrollTop, clientHeight, scrollHeight } = this.box;
    const isAtEnd = this.box.hidden || scrollTop + clientHeight >= scrollHeight - 4;
    this.box.hidden = this.lines.length === 0;
    this.box.textContent = this.lines.join("\n");
    if (isAtEnd) this.box.scrollTop = this.box.scrollHeight;
    if (news.why) this.note.textContent = news.why;
    else if (this.lines.length) this.note.textContent = "";
  }
}

const output = new OutputPart();
const parts = [output, new ParametersPart(), new DatabasePart()];

function fetchParts() {
  for (const part of parts) part.fetch();
}
