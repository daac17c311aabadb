// The page: takes poses from the daemon as fast as they can be drawn, shows them, sends requests.

import { Chart, write } from "./charts.js";
import { Scene } from "./scene.js";

const find = (id) => document.getElementById(id);
const QUALITIES = [["no headset: pose held", "bad"], ["degraded", "fair"], ["partial", "fair"],
  ["full", "good"]];
const RETRY_MS = 1000;
const JOINTS = 22;

let hello = null;
let pose = null;
let isNew = false;
let socket = null;
let height = null;
// Poses drawn, and poses that the daemon made meanwhile.
let shown = 0;
let span = 0;
// When the last credit was granted, ms, and the oldest pose drawn since the last count.
let grantedAt = 0;
let oldest = 0;

let scene = null;
try {
  scene = new Scene(find("scene"));
} catch (error) {
  show(`The wearer cannot be shown: ${error.message}.`);
}

// Says something in the middle of the scene; why there is no scene stays there.
function say(text) {
  if (scene) show(text);
}

function show(text) {
  find("notice").hidden = !text;
  find("notice").textContent = text;
}

const period = () => (hello ? 1000 / hello.rate_hz : 0);
const ages = new Chart(find("age"), find("age-figures"), "--accent");
const intervals = new Chart(find("interval"), find("interval-figures"), "--right", period);

// ---- the connection

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    link("connected", "good");
    say("Waiting for the first pose.");
    grant();
  };
  socket.onmessage = ({ data }) => {
    if (data instanceof ArrayBuffer) takePose(new DataView(data));
    else takeText(JSON.parse(data));
  };
  socket.onclose = () => {
    link("not connected", "bad");
    say("posed does not answer. Trying again.");
    setTimeout(connect, RETRY_MS);
  };
}

// A pose answers a credit: it was the newest then, or is younger. So it is never older than that,
// and one period more.
function grant() {
  if (socket.readyState !== WebSocket.OPEN) return;
  grantedAt = performance.now();
  socket.send("1");
}

const age = () => performance.now() - grantedAt + period();

function link(text, state) {
  find("link").textContent = text;
  find("link").dataset.state = state;
}

// The layout is documented where the daemon writes it (page/message.rs).
function takePose(view) {
  const float = (at) => view.getFloat32(at, true);
  const vector = (at) => [float(at), float(at + 4), float(at + 8)];
  const quaternion = (at) => [...vector(at), float(at + 12)];
  const sequence = view.getUint32(0, true);
  const [quality, tracker, deviceCount, timingCount] = [4, 5, 6, 7].map((at) => view.getUint8(at));
  const [contactCount, thingCount] = [16, 18].map((at) => view.getUint16(at, true));
  let at = 20;
  const joints = [];
  for (let joint = 0; joint < JOINTS; joint++, at += 28) {
    joints.push({ position: vector(at), rotation: quaternion(at + 12) });
  }
  const devices = [];
  for (let device = 0; device < deviceCount; device++, at += 32) {
    const [role, lookup, tracking] = [0, 1, 2].map((byte) => view.getUint8(at + byte));
    devices.push({ role, lookup, tracking, position: vector(at + 4),
      rotation: quaternion(at + 16) });
  }
  const now = performance.now() / 1000;
  for (let timing = 0; timing < timingCount; timing++, at += 8) {
    const time = now - ((timingCount - 1 - timing) * period()) / 1000;
    ages.add(time, float(at));
    intervals.add(time, float(at + 4));
  }
  const contacts = [];
  for (let contact = 0; contact < contactCount; contact++, at += 24) {
    contacts.push({ position: vector(at), force: vector(at + 12) });
  }
  const things = [];
  for (let thing = 0; thing < thingCount; thing++, at += 32) {
    things.push({ position: vector(at), rotation: quaternion(at + 12),
      isTouched: view.getUint32(at + 28, true) > 0 });
  }
  span += pose && sequence > pose.sequence ? sequence - pose.sequence : 1;
  say("");
  pose = { sequence, quality, tracker, joints, devices, contacts, things };
  isNew = true;
}

function takeText(message) {
  if (message.hello) takeHello(message.hello);
  if (message.status) takeStatus(message.status);
}

function takeHello(news) {
  hello = news;
  if (scene) {
    scene.stations = [];
    scene.objects = hello.objects;
    scene.isDirty = true;
  }
  listed.clear();
  find("devices").replaceChildren();
  delete find("trackers").dataset.pressed;
  find("trackers").replaceChildren(...hello.trackers.map((name) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.dataset.tracker = name;
    button.onclick = () => ask({ tracker: name }, `Tracker ${name} is asked for.`);
    return button;
  }));
}

// ---- what is shown

let drawnAt = 0;
function frame(now) {
  requestAnimationFrame(frame);
  scene?.pace(now - drawnAt);
  drawnAt = now;
  scene?.draw(pose);
  if (!isNew) return;
  isNew = false;
  shown += 1;
  const [text, state] = QUALITIES[pose.quality];
  set(find("quality"), text, state);
  const by = hello?.tracker_names[pose.tracker] ?? "";
  set(find("by"), by && `by ${by}`);
  press(find("trackers"), by);
  if (pose.contacts.length && find("force").hidden) find("force").hidden = false;
  document.body.dataset.sequence = pose.sequence;
  // A replay that stands still has no newer pose.
  const old = replaying?.paused ? 0 : age();
  document.body.dataset.age = old;
  oldest = Math.max(oldest, old);
  grant();
}

// Shows which of a group's buttons holds, once for each change.
function press(group, name) {
  if (group.dataset.pressed === name) return;
  group.dataset.pressed = name;
  for (const button of group.children) {
    button.setAttribute("aria-pressed", String(button.dataset.tracker === name));
  }
}

// Writes only what changed: a status that is read aloud must not repeat itself.
function set(element, text, state) {
  if (element.textContent !== text) element.textContent = text;
  if (state && element.dataset.state !== state) element.dataset.state = state;
}

function takeStatus(
  { height_m, devices, stations, ticks, recoveries, starts, recording, replay }) {
  // How often the tracker was told to start anew: for whoever tests the page.
  document.body.dataset.starts = starts;
  if (height !== height_m) {
    height = height_m;
    if (document.activeElement !== find("height")) {
      find("height").value = Math.round(height * 100);
    }
  }
  // Found by their light, they come one by one.
  if (scene && JSON.stringify(scene.stations) !== JSON.stringify(stations)) {
    scene.stations = stations;
    scene.isDirty = true;
  }
  takeRecording(recording);
  takeReplay(replay);
  const connected = devices.filter((device) => device.connected).length;
  find("device-count").textContent = devices.length ? `${connected} of ${devices.length}` : "";
  listDevices(devices);
  if (ticks) {
    write(find("tick-figures"), [
      ["late ticks", `${ticks.late} of ${ticks.done}`],
      ["latest", `${ticks.lateness_max_ms.toFixed(2)} ms`],
      ["real-time", ticks.real_time ? "yes" : "no"],
      ...(recoveries ? [["put back", `${recoveries.falls} falls, ${recoveries.drifts} drifts`]] : []),
    ]);
  }
}

// Items are made anew only where something else than numbers changed: laying out is dear.
const listed = new Map();
function listDevices(devices) {
  const list = find("devices");
  if (devices.length === 0) {
    if (list.firstChild?.className === "none") return;
    const none = document.createElement("li");
    none.className = "none";
    none.textContent = "None is plugged in.";
    list.replaceChildren(none);
    listed.clear();
    return;
  }
  list.querySelector(".none")?.remove();
  const order = ({ role }) => hello.roles.indexOf(role) || hello.roles.length;
  devices.sort((a, b) => order(a) - order(b));
  for (const device of devices) {
    const { id, serial, model, role, connected, charge, charging, how, troubles } = device;
    const shape = JSON.stringify([serial, model, role, connected, charge, charging, how, troubles]);
    let known = listed.get(id);
    if (known?.shape !== shape) {
      const item = deviceItem(device);
      known?.item.remove();
      const after = devices.slice(0, devices.indexOf(device)).at(-1);
      if (after) listed.get(after.id).item.after(item);
      else list.prepend(item);
      known = { shape, item };
      listed.set(id, known);
    }
    deviceNumbers(known.item, device);
  }
}

function deviceNumbers(item, device) {
  if (!device.connected) return;
  const numbers = [`${Math.round(device.rate_hz)}/s`,
    `${Math.round(device.tracked_share * 100)} % of the time`];
  if (device.residual_rad > 0) numbers.push(`${(device.residual_rad * 1000).toFixed(2)} mrad`);
  if (device.errors) numbers.push(`${device.errors} errors`);
  if (device.dropped) numbers.push(`${device.dropped} dropped`);
  set(item.querySelector(".numbers"), numbers.join(" · "));
  const width = `${Math.round(device.tracked_share * 100)}%`;
  const bar = item.querySelector(".share i");
  if (bar.style.width !== width) bar.style.width = width;
}

function deviceItem(device) {
  const item = document.createElement("li");
  item.className = "device";
  const state = !device.connected ? "off" : { optical: "good", inertial: "fair" }[device.how] ?? "bad";
  item.dataset.state = state;
  const part = (tag, name, text) => {
    const element = document.createElement(tag);
    element.className = name;
    element.textContent = text;
    item.append(element);
    return element;
  };
  const tracking = device.connected
    ? { optical: "tracked", inertial: "by inertia alone" }[device.how] ?? "not tracked" : "gone";
  part("span", "dot", "");
  const role = part("span", "role", device.role === "none" ? "no role"
    : device.role.replaceAll("_", " "));
  const how = document.createElement("span");
  how.className = "quiet";
  how.textContent = ` ${tracking}`;
  role.append(how);
  const charge = part("span", "charge", device.charge === null ? ""
    : `${Math.round(device.charge * 100)} %${device.charging ? " ⚡" : ""}`);
  if (device.charge !== null) charge.title = device.charging ? "battery, charging" : "battery";
  if (device.charge !== null && device.charge < 0.15 && !device.charging) {
    charge.dataset.state = "bad";
  }
  part("span", "what", [device.model, device.serial].filter(Boolean).join(" · "));
  if (!device.connected) return item;
  part("span", "numbers", "");
  part("span", "share", "").append(document.createElement("i"));
  for (const trouble of device.troubles) part("span", "trouble", `${trouble}.`);
  return item;
}

setInterval(() => {
  const now = performance.now() / 1000;
  ages.draw(now);
  intervals.draw(now);
}, 250);

// ---- recording and replay

let isRecording = false;
function takeRecording(recording) {
  isRecording = Boolean(recording);
  const button = find("record");
  set(button, isRecording ? "Stop" : "Start");
  if (button.getAttribute("aria-pressed") !== String(isRecording)) {
    button.setAttribute("aria-pressed", String(isRecording));
    find("format").disabled = isRecording;
  }
  set(find("recorded"), recording ? recording.error ?? `${recording.poses} poses` : "");
}

let replaying = null;
let isSeeking = false;
function takeReplay(replay) {
  replaying = replay;
  const bar = find("replay");
  if (bar.hidden === Boolean(replay)) bar.hidden = !replay;
  if (!replay) return;
  const time = find("time");
  time.max = Math.max(replay.length_s, replay.position_s);
  if (!isSeeking) time.value = replay.position_s;
  set(find("clock"), `${clock(isSeeking ? time.value : replay.position_s)} / `
    + (replay.length_s ? clock(replay.length_s) : "…"));
  const pause = find("pause");
  set(pause, replay.paused ? "▶" : "❚❚");
  const label = replay.paused ? "Play" : "Pause";
  if (pause.ariaLabel !== label) pause.ariaLabel = label;
}

const clock = (seconds) => `${Math.floor(seconds / 60)}:`
  + String(Math.floor(seconds % 60)).padStart(2, "0");

find("record").onclick = () => ask(isRecording ? "stop_recording"
  : { record: find("format").value }, "");
find("pause").onclick = () => ask({ pause: !replaying.paused }, "");
find("time").oninput = () => {
  isSeeking = true;
};
find("time").onchange = () => {
  isSeeking = false;
  ask({ seek_s: Number(find("time").value) }, "");
};

let counted = { at: 0, shown: 0, span: 0 };
setInterval(() => {
  const next = { at: performance.now(), shown, span };
  const rate = (name) => Math.round((next[name] - counted[name]) * 1000 / (next.at - counted.at));
  const rates = `${rate("shown")} of ${rate("span")} poses/s shown`;
  find("frames").textContent = pose ? `${rates}, ${Math.round(oldest)} ms old at most` : "";
  oldest = 0;
  counted = next;
}, 1000);

// ---- what is asked for

async function ask(wish, done) {
  const answer = find("answer");
  let [text, state] = [done, ""];
  try {
    const reply = await fetch("control", { method: "POST", body: JSON.stringify(wish),
      headers: { "Content-Type": "application/json" } });
    const said = await reply.text();
    if (!reply.ok) [text, state] = [said, "bad"];
    else if (said) text = said;
  } catch {
    [text, state] = ["posed does not answer.", "bad"];
  }
  answer.textContent = text;
  answer.dataset.state = state;
}

function askHeight(metres) {
  if (metres >= 1 && metres <= 2.5) {
    ask({ height_m: metres }, `Height is set to ${metres.toFixed(2)} m.`);
    return;
  }
  find("answer").textContent = "Give a height from 100 to 250 cm.";
  find("answer").dataset.state = "bad";
  find("height").value = Math.round(height * 100);
}

find("reset").onclick = () => ask("reset", "The tracker starts anew.");
find("height").onchange = () => askHeight(find("height").value / 100);
for (const button of document.querySelectorAll(".step")) {
  button.onclick = () => {
    const metres = find("height").value / 100 + Number(button.dataset.step);
    find("height").value = Math.round(metres * 100);
    askHeight(Math.round(metres * 100) / 100);
  };
}
for (const button of document.querySelectorAll("#views button")) {
  button.onclick = () => scene?.look(button.dataset.view);
}

// ---- colours

const THEMES = ["auto", "dark", "light"];
function theme(name) {
  if (name === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = name;
  find("theme-name").textContent = name;
  localStorage.setItem("theme", name);
  scene?.paint();
}
find("theme").onclick = () => {
  const now = THEMES.indexOf(find("theme-name").textContent);
  theme(THEMES[(now + 1) % THEMES.length]);
};
matchMedia("(prefers-color-scheme: light)").onchange = () => scene?.paint();
theme(THEMES.includes(localStorage.getItem("theme")) ? localStorage.getItem("theme") : "auto");

connect();
requestAnimationFrame(frame);
