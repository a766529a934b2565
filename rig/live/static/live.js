// Fills the page from the stream. The browser asks for each packet when it has drawn the last, never earlier.
import { Charts } from "/live/charts.js";
import { ArmView, pressureColour } from "/live/arm.js";
import { PictureView } from "/live/picture.js";

const EVENTS_SHOWN = 200;
const RETRY_MS = 1000;
const DOUBLE_CLICK_MS = 400;
const OLD_MS = 2000; // values without a newer sample for this time are shown as old
const at = (id) => document.getElementById(id);
const fixed = (x, digits) => (x === null || x === undefined ? "–" : x.toFixed(digits).replace(/^-(?=[0.]+$)/, ""));
const clock = (s) => `${Math.floor(Math.max(0, s) / 60)}:${String(Math.floor(Math.max(0, s) % 60)).padStart(2, "0")}`;

// For tests and for the curious: how many packets were drawn and how old each picture was on the screen [ms].
const seen = (window.softrig = { packets: 0, latency: [], now: null, about: null });

let socket, about, charts, arm, picture, now = null, led = 0;
let sampled = 0, stalled = false;

function ask(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live/stream`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = async (event) => {
    if (typeof event.data === "string") {
      const message = JSON.parse(event.data);
      if (message.about) begin(message.about);
      if (message.answer && at("answer")) at("answer").textContent = message.answer.message;
      return;
    }
    await show(event.data);
    // A hidden page asks seldom: whoever does not look costs nothing.
    if (document.hidden) setTimeout(() => ask({ more: 1 }), 500);
    else requestAnimationFrame(() => ask({ more: 1 }));
  };
  socket.onclose = () => {
    if (now?.state === "ended") return;
    if (!about) return void setTimeout(connect, RETRY_MS);
    state("lost");
    const last = now ? ` The page shows the last values, of ${fixed(now.time_s, 1)} s.` : "";
    banner(`Connection lost. The run continues without this page.${last}`);
    setTimeout(connect, RETRY_MS);
  };
}

function begin(what) {
  about = seen.about = what;
  at("title").textContent = about.title;
  at("simulated").hidden = !about.simulated;
  at("who").textContent = about.operator ? about.who : `${about.who}, view only`;
  at("panel-camera").hidden = !about.measured;
  banner("");
  charts.begin(about);
  arm.begin(about);
  at("event-list").replaceChildren();
  ask({ more: 1 });
}

async function show(data) {
  const length = new DataView(data).getUint32(0, true);
  const packet = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  if (packet.now.time_s !== now?.time_s) sampled = performance.now();
  now = seen.now = packet.now;
  numbers();
  charts.add(packet.pressure, packet.track, now.time_s);
  events(packet.events);
  if (packet.overlay) arm.show(packet.overlay.lines, now.pressure?.measured_bar, now.sections.map(([, point]) => point));
  if (data.byteLength > 4 + length) {
    await picture.show(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }), packet.overlay);
    if (now.tip?.sent_ms) seen.latency.push(now.tip.age_ms + Date.now() - now.tip.sent_ms);
    if (seen.latency.length > 3000) seen.latency.shift();
  }
  seen.packets += 1;
}

// A connection may stay open while nothing arrives, and packets may arrive while nothing is sampled.
function checkAge() {
  if (!about || !now?.pressure || now.state === "ended" || socket.readyState !== WebSocket.OPEN) return;
  const age = performance.now() - sampled;
  if (age > OLD_MS) {
    stalled = true;
    state("stalled");
    banner(`No new values for ${fixed(age / 1000, 0)} s. The page shows the last values, of ${fixed(now.time_s, 1)} s. The run may continue; its terminal shows it.`);
  } else if (stalled) {
    stalled = false;
    state(now.state);
    banner("");
  }
}

function numbers() {
  if (!stalled) state(now.state);
  checkAge();
  const { protocol, timing, pressure } = now, tip = now.tip ?? {};
  at("segment").textContent = `${protocol.segment}${protocol.segment_left_s > 0 ? `, ${clock(protocol.segment_left_s)} left` : ""}`;
  at("progress-bar").style.width = `${(100 * protocol.time_s) / about.duration_s}%`;
  at("clock").textContent = `${clock(protocol.time_s)} of ${clock(about.duration_s)}`;
  at("error").textContent = fixed(tip.error_mm, 2);
  at("error").dataset.frame = tip.frame ?? "";
  at("error-more").textContent = `mean ${fixed(tip.mean_error_mm, 2)} mm${tip.path_error_mm === undefined ? "" : `; path error ${fixed(tip.path_error_mm, 2)} mm`}${tip.seen && tip.seen !== "measured" ? `; tip: ${tip.seen}` : ""}${tip.model_ok === false ? "; model not solved" : ""}`;
  if (!about.measured) at("error-more").textContent = "the rig has no camera: the tip is not measured";
  if (pressure) {
    const setpoints = pressure.setpoint_bar, known = setpoints[0] !== null; // the safe state has none
    if (known) led = setpoints.reduce((best, p, i) => (p > setpoints[best] ? i : best), 0);
    at("pressure").textContent = fixed(pressure.measured_bar[led], 3);
    at("pressure-title").textContent = about.actuators > 1 ? `pressure, actuator ${led + 1}` : "pressure";
    at("pressure-more").textContent = known ? `set-points ${setpoints.map((p) => fixed(p, 3)).join("  ")}` : "safe state";
  }
  const rows = [
    ["control late by", `${fixed(timing.lateness_us, 0)} us`, false],
    ["worst of 1 s", `${fixed(timing.lateness_max_us, 0)} us`, timing.lateness_max_us > 2500],
    ["deadlines missed", timing.missed, timing.missed > 0],
    ...(about.measured
      ? [["frames dropped", timing.dropped, timing.dropped > 0], ["reprojection", `${fixed(tip.reprojection_px, 3)} px`, false]]
      : []),
    ...now.sections.map(([name, , error]) => [`${name} from model`, `${fixed(error, 2)} mm`, false]),
    ...now.inputs.map(([name, value, unit]) => [name, `${value} ${unit}`, false]),
    ...(!about.measured || !now.tip ? [] : [["picture's age", `${fixed(seen.latency.at(-1) ?? tip.age_ms, 0)} ms`, false]]),
  ];
  at("health").replaceChildren(
    ...rows.flatMap(([name, value, late]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value ?? "–", className: late ? "late" : "" }),
    ]),
  );
  estimates(now.estimates);
  at("prompt").hidden = !now.prompt;
  at("prompt-text").textContent = now.prompt ?? "";
  const acting = ["running", "paused", "waiting"].includes(now.state);
  for (const button of document.querySelectorAll("footer [data-do]")) {
    button.disabled = !acting && !(button.id === "stop" || button.id === "vent") || now.state === "ended";
    if (button.id === "skip" && now.state === "paused") button.disabled = true; // a pause holds its pressures
  }
  if (at("pause")) {
    at("pause").dataset.do = now.state === "paused" ? "resume" : "pause";
    at("pause").querySelector(".q-btn__content").textContent = now.state === "paused" ? "Resume" : "Pause";
  }
  if (now.state === "ended") {
    state("ended");
    banner(`Ended at ${fixed(now.time_s, 1)} s: ${now.ended}. The page shows its last values.`, now.aborted);
    for (const name of ["report", "archive"]) at(`link-${name}`).hidden = !now.results.includes(name);
    window.socket?.disconnect(); // NiceGUI's own connection would go on knocking at a page that is gone
  }
}

function estimates(rows) {
  at("panel-estimates").hidden = !rows.length;
  const head = ["parameter", "unit", "estimate", "+-", "began with"];
  at("estimate-rows").replaceChildren(
    ...[head, ...rows].map((cells, i) => {
      const line = document.createElement("tr");
      line.append(...cells.map((text) => Object.assign(document.createElement(i ? "td" : "th"), { textContent: text })));
      return line;
    }),
  );
}

function state(name) {
  at("state").textContent = { lost: "connection lost", stalled: "no new values" }[name] ?? name;
  at("state").dataset.state = name;
  at("softrig").classList.toggle("old", ["lost", "stalled", "ended"].includes(name));
}

function banner(text, bad = true) {
  at("banner-text").textContent = text;
  at("banner").hidden = !text;
  at("banner").classList.toggle("bad", bad);
}

function events(rows) {
  for (const [t, level, source, message] of rows) {
    const line = document.createElement("li");
    line.className = level;
    line.append(Object.assign(document.createElement("time"), { textContent: `${fixed(t, 1)} s` }), `${source}: ${message}`);
    at("event-list").prepend(line);
  }
  while (at("event-list").children.length > EVENTS_SHOWN) at("event-list").lastChild.remove();
}

function wire() {
  for (const button of document.querySelectorAll("footer [data-do]")) button.disabled = true; // until the run can act
  for (const button of document.querySelectorAll("[data-do]")) {
    let acted = -DOUBLE_CLICK_MS;
    button.addEventListener("click", () => {
      const urgent = button.id === "stop" || button.id === "vent";
      if (!urgent && performance.now() - acted < DOUBLE_CLICK_MS) return; // a double click is one wish, not two
      acted = performance.now();
      ask({ do: button.dataset.do });
    });
  }
  at("theme").addEventListener("click", () => {
    window.Quasar.Dark.set(!window.Quasar.Dark.isActive);
    localStorage.setItem("softrig-dark", window.Quasar.Dark.isActive);
  });
  const kept = localStorage.getItem("softrig-dark");
  if (kept !== null) window.Quasar.Dark.set(kept === "true");
  new MutationObserver(() => {
    charts.colours();
    arm.draw();
  }).observe(document.body, { attributes: true, attributeFilter: ["class"] });
}

async function start() {
  while (!at("softrig") || !(charts = Charts.find())) await new Promise((done) => setTimeout(done, 20));
  arm = new ArmView(at("arm-view"), pressureColour);
  picture = new PictureView(at("picture"));
  wire();
  setInterval(checkAge, 250);
  connect();
}

start();
