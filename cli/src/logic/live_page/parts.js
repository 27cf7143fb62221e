"use strict";
// The parts of a live view that ask robots, and only while they are open. Texts of robots become text nodes.

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
    row.root.append(element("span", "", `${name} on ${one.robot} `), row.value, row.spec, form);
    return row;
  }
}

const parts = [new ParametersPart()];

function fetchParts() {
  for (const part of parts) part.fetch();
}
