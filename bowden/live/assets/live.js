// Shows what the stream tells, and how old it is.
// The rule of this file: a value that is older than STALE_S is grey and its age stands above it; text is never HTML.
"use strict";
const STALE_S = 0.5, EVENTS_SHOWN = 200;
const KINDS = { trial: "running trial", bus: "bus, listened to", recorded: "RECORDED trial" };
const at = name => document.getElementById(name);
let told = null, receivedAt = 0, connected = false, epoch = null, rows = [], chart = null;

function number(value, digits) { return value == null ? "–" : value.toFixed(digits).replace("-", "−"); }

function draw() {
  const columns = [0, ...places()].map(place => rows.map(row => row[place]));
  if (!chart) {
    const traces = [["desired", "#6b7280", 2.2], ["START", "#c2410c", 1.4], ["END", "#2563eb", 1.6]];
    const line = place => {
      const [name, stroke, width] = traces[(place - 1) % 3], path = Math.floor((place - 1) / 3);
      return { label: `${told.paths[path]} ${name}`.trim(), stroke, width, dash: path ? [6 - path, 3] : [],
        points: { show: false } };
    };
    const axis = { stroke: "#5b6675", grid: { stroke: "#e6eaef", width: 1 }, ticks: { stroke: "#d9dee5" } };
    chart = new uPlot({
      width: at("plot").clientWidth, height: 320, legend: { show: false }, cursor: { drag: { setScale: false } },
      scales: { x: { time: false, range: () => [Math.max(0, edge() - width()), Math.max(edge(), width())] },
        y: { range: (u, low, high) => [Math.min(0, low ?? 0), Math.max(10, 1.08 * (high ?? 10))] } },
      series: [{}, ...places().map(line)],
      axes: [{ ...axis, label: "bus time (s)", labelSize: 22 }, { ...axis, label: "force (N)", labelSize: 22 }],
    }, columns, at("plot"));
    addEventListener("resize", () => chart.setSize({ width: at("plot").clientWidth, height: 320 }));
  } else chart.setData(columns);
}
function places() { return [...Array(3 * told.paths.length).keys()].map(place => place + 1); }
// The newest value of one force, of each path.
function forces(value) { return told.paths.map((_, path) => value(3 * path)).join(" · "); }
function edge() { return rows.length ? rows[rows.length - 1][0] : 0; }
function width() { return told ? told.window_s : 20; }

function cells(body, lines) {
  body.replaceChildren(...lines.map(line => {
    const row = document.createElement("tr");
    for (const [text, kind] of line) {
      const cell = document.createElement("td");
      cell.textContent = text;
      if (kind) cell.className = kind;
      row.append(cell);
    }
    return row;
  }));
}

function take(message) {
  if (message.epoch !== epoch) { epoch = message.epoch; rows = []; at("events").replaceChildren(); }
  told = message;
  receivedAt = performance.now();
  rows.push(...message.rows);
  const from = edge() - message.window_s;
  rows = rows.filter(row => row[0] >= from);
  for (const event of message.events) {
    const row = document.createElement("tr");
    event.forEach((value, place) => {
      const cell = document.createElement("td");
      cell.textContent = place ? value : value.toFixed(3);
      row.append(cell);
    });
    at("events").prepend(row);
  }
  while (at("events").children.length > EVENTS_SHOWN) at("events").lastChild.remove();
  at("none").hidden = at("events").children.length > 0;
  at("name").textContent = message.name;
  at("suspicion").textContent = message.suspicion;
  at("suspicion").hidden = !message.suspicion;
  at("kind").textContent = KINDS[message.kind] || message.kind;
  at("stop").disabled = !message.stop.can || message.stop.asked || message.status === "ended";
  at("why").textContent = message.stop.asked ? "Safe stop requested." : message.stop.can ? (message.status === "ended"
    ? "The trial has ended." : "Ends the trial as Ctrl-C does: the tension is let go, the drives are disabled, the file is kept.") : message.stop.why;
  at("player").hidden = !message.player;
  if (message.player) controls(message.player, message.status);
  const row = rows[rows.length - 1] || [];
  at("desired").textContent = forces(first => number(row[first + 1], 1));
  at("start").textContent = forces(first => number(row[first + 2], 1));
  at("end").textContent = forces(first => number(row[first + 3], 1));
  at("error").textContent = forces(first => number(
    row[first + 1] == null || row[first + 3] == null ? null : row[first + 3] - row[first + 1], 1));
  at("load").textContent = number(message.load_percent, 1);
  draw();
}

function controls(player, status) {
  at("play").textContent = status === "running" ? "Pause" : "Play";
  at("position").max = player.length_s;
  if (document.activeElement !== at("position")) at("position").value = player.at_s;
  at("played").textContent = `${player.at_s.toFixed(1)} of ${player.length_s.toFixed(1)} s`;
}
function ask(control, more) {
  return fetch(`player?${new URLSearchParams({ control, ...more })}`, { method: "POST", headers: { "X-Bowden-Token": TOKEN } });
}

// Ages go on between messages, and when none comes any more.
function clock() {
  const since = (performance.now() - receivedAt) / 1000;
  const age = told && told.age_s != null ? told.age_s + since : null;
  const ended = told && told.status === "ended", paused = told && told.status === "paused";
  const stale = age == null || age > STALE_S || ended || paused;
  document.body.classList.toggle("stale", stale);
  at("age").textContent = (!connected && !ended ? "no connection to bowden; " : "") + (
    ended ? `ended${told.sentence ? `: ${told.sentence}` : ""}; the values are the last ones`
    : paused ? "paused; the values are the last ones"
    : age == null ? "no data yet" : stale ? `no data for ${age.toFixed(1)} s` : "data is live");
  at("status").textContent = ended ? "ended" : !connected ? "not connected" : stale && !paused ? "stale" : told ? told.status : "";
  at("status").className = `badge ${ended || paused ? "plain" : stale ? "bad" : "good"}`;
  if (!connected) at("stop").disabled = true;
  if (!told) return;
  cells(at("nodes"), told.nodes.map(node => {
    const silence = node.age_s == null ? null : node.age_s + (ended || paused ? 0 : (told.age_s ?? 0) + since);
    const lost = silence != null && silence > told.silent_s && !ended && !paused;
    return [[`${node.name} (${node.id})`], [node.state ?? "never heard"], [number(silence, 2), lost ? "figure lost" : "figure"],
      [silence == null ? "" : lost ? `no heartbeat for ${silence.toFixed(1)} s; the state is the last one told` : "", "lost"]];
  }));
}

const stream = new EventSource(`stream?token=${encodeURIComponent(TOKEN)}`);
stream.onopen = () => { connected = true; epoch = null; };  // a new stream begins with all that is kept
stream.onerror = () => { connected = false; clock(); };
stream.onmessage = event => {
  connected = true;
  take(JSON.parse(event.data));
  clock();
  if (told.status === "ended" && told.kind !== "recorded") stream.close();
};
at("stop").onclick = async () => {
  at("stop").disabled = true;
  try {
    const answer = await fetch("stop", { method: "POST", headers: { "X-Bowden-Token": TOKEN } });
    at("why").textContent = answer.ok ? "Safe stop requested." : `Not stopped: ${await answer.text()}`;
  } catch (error) {
    at("why").textContent = `Not stopped: no connection (${error.message}). Press Ctrl-C in bowden's terminal, or the emergency stop.`;
  }
};
at("play").onclick = () => ask(told.status === "running" ? "pause" : "play", {});
at("speed").onchange = () => ask("seek", { speed: at("speed").value });
at("position").onchange = () => { at("position").blur(); ask("seek", { at: at("position").value }); };
setInterval(clock, 100);
