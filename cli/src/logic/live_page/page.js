"use strict";
// The page of a live view. Texts of robots become text nodes, so nothing of them is markup. `missions.js` draws the missions, and
// `parts.js` the parts that ask robots.
const EVENTS_MAX = 500;
// Seconds without a sign of the view after which an order is taken back.
const GIVE_UP_AFTER = 5;
let ages = { all: null, robots: {}, limit: 3 };
let heard = null;

function forget(mission) {
  model.deployments.delete(mission);
  for (const part of [model.processes, model.wires]) {
    for (const [key, item] of part) if (item.mission === mission) part.delete(key);
  }
}

function take(data) {
  if (data.whole) {
    for (const part of ["robots", "deployments", "processes", "wires"]) model[part].clear();
    model.events = [];
    // Another view may give its plans the same numbers.
    cards.clear();
  }
  for (const gone of data.gone) {
    if (gone.robot !== undefined) model.robots.delete(gone.robot);
    else if (gone.process !== undefined) model.processes.delete(`${gone.mission}:${gone.process}`);
    else if (gone.wire !== undefined) model.wires.delete(`${gone.mission}:${gone.wire}`);
    else forget(gone.mission);
  }
  const dated = (item) => Object.assign(item, { at: item.age === null || item.age === undefined ? null : now() - item.age });
  for (const robot of data.robots) model.robots.set(robot.host, robot);
  for (const live of data.deployments) model.deployments.set(live.id, dated(live));
  for (const process of data.processes) model.processes.set(`${process.mission}:${process.path}`, dated(process));
  for (const wire of data.wires) model.wires.set(`${wire.mission}:${wire.name}`, wire);
  model.events.push(...data.events);
  model.events.splice(0, Math.max(0, model.events.length - EVENTS_MAX));
  model.questions = data.questions;
}

function drawRobots() {
  const cards = [...model.robots.values()].sort((a, b) => (a.host < b.host ? -1 : 1)).map((robot) => {
    const told = ages.robots[robot.host];
    // While the view is silent, nothing that it has told is live.
    const old = told === null || told === undefined ? null : told + now() - (heard ?? now());
    const stale = robot.presence !== "here" || old === null || old >= ages.limit;
    const card = element("li", stale || robot.estop ? "bad" : "");
    card.append(element("b", "", robot.host), " ");
    const word = robot.estop ? "stopped" : robot.presence === "here" && stale ? "not live" : robot.presence;
    card.append(element("span", stale || robot.estop ? "bad" : "good", word));
    if (stale && old !== null) card.append(element("small", "bad", `data is ${age(old)} old`));
    if (robot.why) card.append(element("small", "", robot.why));
    if (robot.estop) card.append(element("small", "", robot.estop));
    if (robot.up !== null) card.append(element("small", "", `DCA ${robot.version}`));
    if (robot.database) card.append(element("small", "", `databases ${robot.database}`));
    for (const waiting of robot.waiting) card.append(element("small", "", waiting));
    return card;
  });
  byId("robots").replaceChildren(...cards);
}

function drawWires() {
  const lossy = [...model.wires.values()].filter((wire) => wire.lost || wire.refused);
  const rows = lossy.map((wire) => {
    const words = `${wire.lost} lost (${wire.lostASecond.toFixed(1)} a second), ${wire.refused} refused`;
    const row = element("li", "", `${wire.name}  `);
    row.append(element("span", wire.lostASecond > 0 ? "bad" : "changing", words));
    return row;
  });
  byId("wires").replaceChildren(...(rows.length ? rows : [element("li", "quiet", "no wire has lost a value")]));
}

function drawEvents() {
  const filter = byId("filter").value.toLowerCase();
  const rows = [];
  for (const event of [...model.events].reverse()) {
    const words = `${event.host}  ${event.deployment ?? ""}  ${event.path ?? ""}  ${event.text}`;
    if (!words.toLowerCase().includes(filter)) continue;
    const row = element("li", event.failure ? "failed" : "");
    const time = event.time === null ? "" : new Date(event.time * 1000).toISOString().slice(11, 19);
    row.append(element("time", "", time), words);
    rows.push(row);
    if (rows.length === 200) break;
  }
  byId("events").replaceChildren(...(rows.length ? rows : [element("li", "quiet", "no event")]));
}

let drawnQuestions = "";
function drawQuestions() {
  const text = JSON.stringify(model.questions);
  // A button that is being pressed stays the same button.
  if (text === drawnQuestions) return;
  drawnQuestions = text;
  const items = model.questions.map((question) => {
    const item = element("li");
    item.append(element("b", "", question.text), element("div", "quiet", `${question.deployment}:${question.path}`));
    for (const option of question.options) {
      const button = element("button", "", option);
      button.type = "button";
      const { mission, path, number } = question;
      button.addEventListener("click", () => order("/answer", { mission, path, question: number, option }));
      item.append(button);
    }
    return item;
  });
  byId("questions").replaceChildren(...items);
  byId("questions-part").hidden = items.length === 0;
}

function drawAlarms() {
  const silent = heard === null ? null : now() - heard;
  const old = silent === null ? null : Math.max(silent >= ages.limit ? silent : 0, ages.all ?? Infinity);
  const isStale = old === null || old >= ages.limit;
  byId("stale").hidden = !isStale;
  const words = old === null || old === Infinity ? "no data yet" : `not live since ${Math.floor(old)} s`;
  byId("stale").textContent = isDisplaced ? `${words}: other windows show this page; click here to go on` : words;
  const stopped = [...model.robots.values()].filter((robot) => robot.estop);
  byId("stopped").hidden = stopped.length === 0;
  byId("stopped").textContent = stopped.length ? `Everything is stopped on ${stopped.map((one) => one.host).join(", ")}: ${stopped[0].estop}` : "";
  byId("release").hidden = stopped.length === 0;
  const failed = [...model.processes.values()].filter((one) => one.health === "failed").length;
  const count = (number, one, many) => `${number} ${number === 1 ? one : many}`;
  const counts = `${count(model.robots.size, "robot", "robots")}, ${count(model.processes.size, "process", "processes")}`;
  byId("summary").textContent = failed ? `${counts}, ${failed} failed` : counts;
}

function draw() {
  drawRobots();
  drawMissions();
  drawWires();
  drawEvents();
  drawQuestions();
  drawAlarms();
}

async function order(path, body) {
  byId("word").textContent = "…";
  byId("word").className = "";
  const given = now();
  const left = new AbortController();
  // An order that nobody takes is taken back, so that it is not carried out much later.
  const look = setInterval(() => {
    if (now() - given > GIVE_UP_AFTER && now() - (heard ?? 0) > GIVE_UP_AFTER) left.abort();
  }, 500);
  let word = "";
  let isDone = false;
  try {
    const headers = { "X-Dca-Token": token, "Content-Type": "application/json" };
    const answer = await fetch(path, { method: "POST", headers, body: JSON.stringify(body), signal: left.signal });
    word = await answer.text();
    isDone = answer.ok;
    if (answer.status === 403) word = "NOT DONE: this window belongs to a view that has ended; open the link that `dca view --page` prints now";
  } catch (error) {
    word = left.signal.aborted ? "NOT DONE: the view does not answer; `dca estop` on a terminal stops everything" : `NOT DONE: ${error.message}`;
  }
  clearInterval(look);
  byId("word").textContent = word;
  byId("word").className = isDone ? "" : "failed";
}

function sure(text, action) {
  const dialog = byId("sure");
  byId("sure-text").textContent = text;
  dialog.returnValue = "no";
  dialog.onclose = () => {
    if (dialog.returnValue === "yes") action();
  };
  dialog.showModal();
}

byId("estop").addEventListener("click", () => sure("Stop everything on all robots at once?", () => order("/estop", {})));
byId("release").addEventListener("click", () => sure("Let programs begin again on all robots?", () => order("/release", {})));
byId("filter").addEventListener("input", drawEvents);

// A browser permits a host six connections, and each stream is one. So a page that nobody sees has none, and all pages of a
// browser together have no more than there are locks: orders need a connection, too. A page that is opened takes the lock of another.
const STREAMS_MAX = 4;
let stream = null;
let position = "";
let letGo = () => {};
let isAsking = false;
let isDisplaced = false;

function leave() {
  stream?.close();
  stream = null;
  letGo();
  letGo = () => {};
}

// Resolves to whether the lock is held, which it is until `letGo` is called or another page takes it.
function hold(number, options) {
  return new Promise((resolve) => {
    const held = (lock) => {
      resolve(lock !== null);
      return lock === null ? undefined : new Promise((release) => (letGo = release));
    };
    navigator.locks.request(`stream ${number}`, options, held).catch(() => {
      isDisplaced = true;
      leave();
    });
  });
}

async function follow() {
  if (document.hidden) return leave();
  if (stream !== null || isAsking) return;
  isAsking = true;
  let isHeld = false;
  for (let number = 0; number < STREAMS_MAX && !isHeld; number += 1) isHeld = await hold(number, { ifAvailable: true });
  if (!isHeld) await hold(Math.floor(Math.random() * STREAMS_MAX), { steal: true });
  isAsking = isDisplaced = false;
  listen();
}

function listen() {
  stream = new EventSource(`/events?after=${position}${output.query()}`);
  stream.addEventListener("message", hear);
}

// Opens the stream again, for the output of another process.
function reopen() {
  if (stream === null) return;
  stream.close();
  listen();
}

function hear(message) {
  position = message.lastEventId;
  const data = JSON.parse(message.data);
  heard = now();
  ages = data.ages;
  if (data.output) output.take(data.output);
  if (data.robots) {
    take(data);
    draw();
  } else {
    drawRobots();
    drawAlarms();
  }
}

document.addEventListener("visibilitychange", follow);
for (const event of ["focus", "pointerdown", "keydown"]) window.addEventListener(event, follow);
follow();
setInterval(() => {
  drawRobots();
  drawAlarms();
  fetchPictures();
  fetchParts();
}, 500);
