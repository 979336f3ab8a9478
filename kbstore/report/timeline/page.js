"use strict";
// The page of a timeline. Times are nanoseconds after `data.origin`, exact as numbers for 104 days. A row is what one
// assertion says: it is known from transaction `from` on, until `gone` cancelled or superseded it. A belief is the number
// of a transaction: what was known after it. The one after the latest stands for now.

const byId = (name) => document.getElementById(name);
const canvas = byId("lanes"), pen = canvas.getContext("2d");
const LABELS = 280, TICKS = 46, HEIGHT = 20, NUMBER = 40;
const INITIAL = 1, END = 2, FROM = 3, GONE = 4, ENDED = 5, HOW = 6, VALUE = 7, RATE = 8;
const CANCELLED = 1;
const ORDER = ["run", "goal", "fact", "number", "object", "other"];
let data, NOW, origin, transactions, groups, lanes, cuts, objects;      // what there is to show
let view, cursor, belief, utc = true, visible = [], asked = [], scroll = 0, chosen = null, wanted = [];
const closed = new Set(), folded = new Map();      // the groups that are folded; and what somebody has folded or unfolded

// -- what holds -----------------------------------------------------------------------------------------------

// Take data, the first or, of a page that is live, later ones.
function absorb(found) {
  data = found; NOW = data.latest + 1; origin = BigInt(data.origin); chosen = null; painted = "";
  for (const group of groups ?? []) if (closed.has(group) !== group.isFolded) folded.set(`${group.kind} ${group.name}`, closed.has(group));
  closed.clear(); transactions = new Map(data.transactions.map((tx) => [tx[0], tx]));
  groups = data.groups.map(([kind, name], index) => ({ kind, name, index, lanes: [] }));
  lanes = data.lanes.map(([group, label, objects]) => ({ group: groups[group], label, objects, rows: [], expected: [], runs: [], reached: [], scheduled: {} }));
  cuts = new Map();      // for each belief, the first time of which what is expected differs from what is recorded
  for (const lane of lanes) {
    lane.group.lanes.push(lane);
    lane.text = lane.group.kind === "fact" || lane.group.kind === "number" ? `(${[lane.group.name, lane.label].filter(Boolean).join(" ")})` : lane.label;
    lane.search = `${lane.group.name} ${lane.text}`.toLowerCase();
  }
  for (const row of data.rows) lanes[row[0]].rows.push(row);
  for (const row of data.expected) { lanes[row[0]].expected.push(row); cuts.set(row[FROM], Math.min(row[INITIAL], cuts.get(row[FROM]) ?? Infinity)); }
  for (const [lane, started, expected, ended, outcome, from, gone, broken] of data.runs) lanes[lane].runs.push({ started, expected, ended, outcome, from, gone, broken });
  for (const [lane, spans] of data.reached) lanes[lane].reached = spans;
  objects = new Map(lanes.filter((lane) => lane.group.kind === "object").map((lane) => [lane.label.toLowerCase(), lane]));
  for (const lane of lanes) {
    lane.about = lane.group.kind === "object" ? [] : lane.objects.map((name) => objects.get(name)).filter(Boolean);
    lane.rows.sort((a, b) => a[INITIAL] - b[INITIAL] || a[FROM] - b[FROM]);
  }
  for (const group of groups) {
    // nothing has happened to it since the beginning: a map, say
    const isFixed = ({ rows, expected }) => rows.length === 1 && rows[0][INITIAL] <= (data.transactions[0]?.[1] ?? 0) && rows[0][END] === null && !rows[0][RATE] && !expected.length;
    group.isFixed = group.kind === "object" || ((group.kind === "fact" || group.kind === "number") && group.lanes.every(isFixed));
    group.isSingle = group.lanes.length === 1 && !group.isFixed && (group.kind === "fact" || group.kind === "number");
    group.isFolded = group.isFixed || (lanes.length > 80 && group.lanes.length > 12);
    if (folded.get(`${group.kind} ${group.name}`) ?? group.isFolded) closed.add(group);
  }
  groups.sort((a, b) => a.isFixed - b.isFixed || ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind) || a.isSingle - b.isSingle || a.index - b.index);
  byId("name").textContent = data.name; document.title = `${data.name} - timeline`;
  byId("asof").min = data.base; byId("asof").max = NOW;
}

function number(row, t) { return row[RATE] ? row[VALUE] + row[RATE] * ((t - row[INITIAL]) / 1e9) : row[VALUE]; }
function timeOf(n) { return n > data.latest ? data.now : transactions.get(n)?.[1] ?? -Infinity; }

// What holds on a lane by a belief: [start, end, row] in order. A row holds until the next one begins, its end is known,
// or one of its objects comes to a scheduled end (rules V1, C9, Q2).
function pieces(lane, n) {
  if (lane.known === n) return lane.pieces;
  const cut = cuts.get(n) ?? Infinity;
  const rows = lane.rows.filter((row) => row[FROM] <= n && !(row[GONE] && row[GONE] <= n) && row[INITIAL] < cut)
    .map((row) => (row.length > 9 && row[INITIAL] > timeOf(n) ? (lane.scheduled[`${row[FROM]} ${row[INITIAL]}`] ??= Object.assign([...row], { [RATE]: row[9] })) : row));
  if (cut < Infinity) for (const row of lane.expected) if (row[FROM] === n) {
    // what comes as it was recorded is shown as that
    const twin = lane.rows.find((other) => other[INITIAL] === row[INITIAL] && other[FROM] <= n && !(other[GONE] && other[GONE] <= n) && other[VALUE] === row[VALUE] && other[RATE] === row[RATE]);
    rows.push(twin ?? row);
  }
  lane.known = n; lane.pieces = []; lane.low = Infinity; lane.high = -Infinity;
  for (const [index, row] of rows.entries()) {
    let end = rows[index + 1]?.[INITIAL] ?? Infinity;
    if (row[ENDED] && row[ENDED] <= n) end = Math.min(end, row[END]);
    for (const object of lane.about) for (const other of object.rows)
      if (other[VALUE] === 0 && other[INITIAL] > row[INITIAL] && other[INITIAL] < end && other[FROM] <= n && !(other[GONE] && other[GONE] <= n)) end = other[INITIAL];
    if (end <= row[INITIAL] || row[VALUE] === null) continue;
    lane.pieces.push([row[INITIAL], end, row]);
    if (lane.group.kind === "number") for (const value of [row[VALUE], number(row, Math.max(row[INITIAL], Math.min(end, data.until)))]) { lane.low = Math.min(lane.low, value); lane.high = Math.max(lane.high, value); }
  }
  return lane.pieces;
}
// The index of the first piece that ends after t.
function firstAfter(found, t) {
  let low = 0, high = found.length;
  while (low < high) { const middle = (low + high) >> 1; if (found[middle][1] > t) high = middle; else low = middle + 1; }
  return low;
}
function standing(lane, t, n) {
  const found = pieces(lane, n), piece = found[firstAfter(found, t)];
  return piece && piece[0] <= t ? piece[2] : null;
}
const isRunning = (run, n) => run.from <= n && !(run.gone && run.gone <= n);
function state(t = cursor, n = belief) { return lanes.map((lane) => [lane, standing(lane, t, n)]).filter(([, row]) => row); }
function said(lane, row, t) {
  if (lane.group.kind === "number") return `(= ${lane.text} ${number(row, t)})`;
  if (lane.group.kind === "object") return row[VALUE] ? `${lane.label} - ${row[RATE]}` : null;
  return row[VALUE] ? lane.text : `(not ${lane.text})`;
}
// What tests, and other scripts, read and do.
window.kbstore = {
  facts: (t, n) => window.kbstore.state(t, n, "fact"),
  state: (t, n, kind) => state(t, n).filter(([lane]) => lane.group.kind === kind).map(([lane, row]) => said(lane, row, t)).filter(Boolean).sort(),
  jump: (t, n = belief) => { cursor = t; setBelief(n); draw(); },
  places: () => visible.map((line) => ({ text: line.group ? line.group.name : line.lane.text, y: line.y - scroll, height: line.height })),
  x: (t) => x(t),
};

// -- time -----------------------------------------------------------------------------------------------------

function clock(t) {
  const ns = origin + BigInt(Math.round(t)), date = new Date(Number(ns / 1000000n)), two = (part) => String(part).padStart(2, "0");
  const shown = utc ? date : new Date(date - date.getTimezoneOffset() * 60000);
  const fraction = ns % 1000000000n ? "." + String(ns % 1000000000n).padStart(9, "0").replace(/0+$/, "") : "";
  return `${shown.getUTCFullYear()}-${two(shown.getUTCMonth() + 1)}-${two(shown.getUTCDate())} ${two(shown.getUTCHours())}:${two(shown.getUTCMinutes())}:${two(shown.getUTCSeconds())}${fraction}`;
}
const isOneDay = () => clock(0).slice(0, 10) === clock(data.until).slice(0, 10);
const short = (t) => (isOneDay() && clock(t).slice(0, 10) === clock(0).slice(0, 10) ? clock(t).slice(11) : clock(t));
// A click means a round time: to the power of ten that is not above a pixel.
function rounded(t) { const unit = 10 ** Math.max(0, Math.floor(Math.log10((view[1] - view[0]) / canvas.clientWidth))), off = Number(origin % BigInt(unit)); return Math.round((t + off) / unit) * unit - off; }
function span(t) {
  const s = t / 1e9, of = (value, unit) => `${Math.round(value)} ${unit}`;
  if (s < 120) return s < 1 ? `${Math.round(s * 1e6) / 1e3} ms` : `${Math.round(s * 1e3) / 1e3} s`;
  return s < 7200 ? `${Math.floor(s / 60)} min ${of(s % 60, "s")}` : s < 172800 ? `${Math.floor(s / 3600)} h ${of((s % 3600) / 60, "min")}` : of(s / 86400, "d");
}
const round = (value) => String(Number(value.toPrecision(6)));
const x = (t) => LABELS + ((t - view[0]) / (view[1] - view[0])) * (canvas.clientWidth - LABELS);
const timeAt = (px) => Math.round(view[0] + ((px - LABELS) / (canvas.clientWidth - LABELS)) * (view[1] - view[0]));

// -- drawing --------------------------------------------------------------------------------------------------

const colours = {}, hatches = {}, back = document.createElement("canvas");
let painted = "", changed = 0, family = "sans-serif";     // `changed` counts foldings and choices
function takeColours() {
  const style = getComputedStyle(document.documentElement);
  family = getComputedStyle(document.body).fontFamily;
  for (const name of ["ground", "panel", "ink", "dim", "line", "true", "false", "number", "run", "object", "goal", "other", "cursor", "bad"]) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
    const tile = document.createElement("canvas"), ink = tile.getContext("2d");
    tile.width = tile.height = 6; ink.strokeStyle = colours[name]; ink.lineWidth = 1.8;
    ink.beginPath(); for (const by of [-6, 0, 6]) { ink.moveTo(by - 1, 7); ink.lineTo(by + 7, -1); } ink.stroke();
    hatches[name] = pen.createPattern(tile, "repeat");
  }
}

function layout() {
  visible = []; asked = [];
  let y = TICKS;
  for (const group of groups) {
    const shown = wanted.length ? group.lanes.filter((lane) => wanted.every((word) => lane.search.includes(word))) : group.lanes;
    if (!shown.length) continue;
    if (group.isSingle && visible.length && !visible.at(-1).lane?.group.isSingle) y += 6;
    asked.push([group, shown]);
    if (!group.isSingle) { visible.push({ group, y, height: HEIGHT + 4, lanes: shown }); y += HEIGHT + 4; }
    if (closed.has(group) && !group.isSingle && !wanted.length) continue;
    for (const lane of shown) { const height = group.kind === "number" ? NUMBER : HEIGHT; visible.push({ lane, y, height }); y += height; }
  }
  scroll = Math.max(0, Math.min(scroll, y - canvas.clientHeight + 12));
}

function draw() {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = `12px ${family}`; pen.textBaseline = "middle";
  layout();
  const seen = visible.filter((line) => line.y - scroll + line.height > TICKS && line.y - scroll < height);
  // the lanes are drawn again only where something else than the cursor has moved
  const place = [width, height, ratio, ...view, belief, scroll, utc, colours.ground, wanted, changed].join();
  if (place === painted) { pen.setTransform(1, 0, 0, 1, 0, 0); pen.drawImage(back, 0, 0); pen.setTransform(ratio, 0, 0, ratio, 0, 0); } else paint(seen, width, height, place);
  drawLines(width, height);
  for (const line of seen) within(0, TICKS, LABELS, height, () => drawLabel(line, line.y - scroll));
  describe();
  remember();
}
function paint(seen, width, height, place) {
  pen.fillStyle = colours.ground; pen.fillRect(0, 0, width, height);
  drawTicks(width, height);
  for (const line of seen) within(LABELS, TICKS, width, height, () => (line.group ? drawGroup(line, line.y - scroll, width) : drawLane(line.lane, line.y - scroll, line.height, width)));
  const edge = x(timeOf(belief));
  if (edge < width) {
    // what lies ahead of the belief is known less well
    for (const [veil, name] of [[0.35, "ground"], [0.05, "goal"]]) { pen.globalAlpha = veil; pen.fillStyle = colours[name]; pen.fillRect(Math.max(LABELS, edge), TICKS, width, height); }
    pen.globalAlpha = 1;
  }
  back.width = canvas.width; back.height = canvas.height; back.getContext("2d").drawImage(canvas, 0, 0); painted = place;
}
function within(left, top, right, bottom, what) { pen.save(); pen.beginPath(); pen.rect(left, top, right - left, bottom - top); pen.clip(); what(); pen.restore(); }
function bar(left, y, size, height) { pen.beginPath(); pen.roundRect(left, y, size, height, Math.min(3, size / 2)); }
function stroke(x1, y1, x2, y2) { pen.beginPath(); pen.moveTo(x1, y1); pen.lineTo(x2, y2); pen.stroke(); }

function drawLabel(line, y) {
  const middle = y + line.height / 2, group = line.group ?? line.lane.group;
  if (line.group) {
    pen.fillStyle = colours.panel; pen.fillRect(0, y, LABELS, line.height);
    pen.fillStyle = colours.ink; pen.font = pen.font.replace("12px", "600 12px");
    pen.fillText(`${closed.has(group) && !wanted.length ? "▸" : "▾"}  ${group.name}`, 8, middle);
    const after = 8 + pen.measureText(`▾  ${group.name}`).width + 8;
    pen.font = pen.font.replace("600 ", ""); pen.fillStyle = colours.dim;
    return pen.fillText(String(line.lanes.length), after, middle);
  }
  const lane = line.lane, row = standing(lane, cursor, belief);
  let right = LABELS - 24, top = middle;
  if (group.kind === "number") {
    const text = row ? round(number(row, cursor)) : "undefined";
    pen.fillStyle = row ? colours.number : colours.dim; pen.textAlign = "right"; pen.fillText(text, LABELS - 10, middle); pen.textAlign = "left";
    right = LABELS - 18 - pen.measureText(text).width; top = middle - 7;
  } else {
    const run = lane.runs.find((each) => each.started <= cursor && cursor < runEnd(each) && each.from <= belief);
    const name = run ? "run" : row ? tone(lane, row) : null;
    pen.beginPath(); pen.arc(LABELS - 14, middle, 3.5, 0, 7);
    if (name) { pen.fillStyle = colours[name]; pen.fill(); } else { pen.strokeStyle = colours.line; pen.stroke(); }
  }
  pen.fillStyle = row || lane.runs.length ? colours.ink : colours.dim;
  pen.beginPath(); pen.rect(0, y, right, line.height); pen.clip();
  const after = group.isSingle ? 22 : 24;
  let indent = after;
  if (group.isSingle) { pen.font = pen.font.replace("12px", "600 12px"); pen.fillText(group.name, after, top); indent += pen.measureText(`${group.name} `).width + 4; pen.font = pen.font.replace("600 ", ""); }
  pen.fillText(group.kind === "run" ? lane.label.slice(1, -1) : lane.label || (group.isSingle ? "" : lane.text), indent, top);
  if (group.kind !== "number" || lane.low > lane.high) return;
  pen.font = pen.font.replace("12px", "10px"); pen.fillStyle = colours.dim;
  pen.fillText(lane.low === lane.high ? "constant" : `${round(lane.low)} to ${round(lane.high)}`, after, middle + 9); pen.font = pen.font.replace("10px", "12px");
}

function drawGroup(line, y, width) {
  pen.fillStyle = colours.panel; pen.fillRect(0, y, width, line.height);
  if (!closed.has(line.group) || wanted.length) return;
  // a closed group is one lane: how many of its lanes have something in each pixel
  const density = new Float32Array(width + 2), put = (start, end) => {
    const left = Math.max(LABELS, Math.floor(x(start))), right = Math.min(width, Math.max(left + 1, Math.ceil(x(end))));
    if (right > left && left <= width) { density[left] += 1; density[right] -= 1; }
  };
  for (const lane of line.lanes) {
    for (const [start, end, row] of pieces(lane, belief)) if (row[VALUE] || lane.group.kind === "number") put(start, end);
    for (const run of lane.runs) if (run.from <= belief) put(run.started, runEnd(run));
  }
  pen.fillStyle = colours[line.group.kind === "fact" ? "true" : line.group.kind];
  for (let px = LABELS, depth = 0; px < width; px += 1) {
    depth += density[px];
    if (depth > 0) { pen.globalAlpha = 0.2 + 0.6 * Math.min(1, depth / line.lanes.length); pen.fillRect(px, y + 7, 1, line.height - 14); }
  }
  pen.globalAlpha = 1;
}

const tone = (lane, row) => (lane.group.kind === "number" ? "number" : row[VALUE] === 0 ? "false" : lane.group.kind === "fact" ? "true" : lane.group.kind);
function drawLane(lane, y, height, width) {
  pen.strokeStyle = colours.line; pen.lineWidth = 1; pen.globalAlpha = 0.6; stroke(LABELS, y + height - 0.5, width, y + height - 0.5); pen.globalAlpha = 1;
  if (lane.group.kind === "run") return lane.runs.filter((run) => run.from <= belief).forEach((run) => drawRun(run, y, height));
  for (const row of lane.rows) if (row[GONE] && row[GONE] <= belief && row[HOW] !== CANCELLED) drawGone(lane, row, y, height);
  if (lane.group.kind === "number") drawNumber(lane, y, height, width);
  else drawPieces(lane, y, height, width);
  for (const row of lane.rows) if (row[GONE] && row[GONE] <= belief && row[HOW] === CANCELLED) drawGone(lane, row, y, height);
  for (const [start, end] of lane.reached) for (const [since, until] of pieces(lane, belief)) {
    const left = x(Math.max(start, since)), right = x(Math.min(end ?? data.now, until, timeOf(belief)));
    if (right > left) { bar(left + 0.5, y + 4.5, Math.max(2, right - left - 1), height - 9); pen.fillStyle = colours.goal; pen.fill(); }
    if (right > left + 60) { pen.fillStyle = colours.ground; pen.fillText("✓ reached", Math.max(left, LABELS) + 6, y + height / 2 + 0.5); }
  }
}
function drawPieces(lane, y, height, width) {
  const found = pieces(lane, belief), first = firstAfter(found, view[0]);
  for (let index = first, last = -Infinity; index < found.length && found[index][0] <= view[1]; index += 1) {
    const [start, end, row] = found[index], left = Math.max(x(start), LABELS - 6), right = Math.min(x(end), width + 6);
    if (right - last < 0.4) continue;
    last = right;
    const size = Math.max(2, right - left), name = tone(lane, row), isScheduled = row[FROM] && row[INITIAL] > timeOf(row[FROM]), isExpected = lane.expected.includes(row);
    bar(left + 0.5, y + 4.5, size - 1, height - 9);
    if (isScheduled || isExpected) {
      pen.strokeStyle = colours[name]; pen.setLineDash(isExpected ? [4, 3] : []); pen.stroke(); pen.setLineDash([]);
      pen.globalAlpha = 0.14; pen.fillStyle = colours[name]; pen.fill(); pen.globalAlpha = 1;
      if (!isExpected) { pen.fillStyle = hatches[name]; pen.fill(); }
    } else { pen.globalAlpha = name === "goal" ? 0.28 : 1; pen.fillStyle = colours[name]; pen.fill(); pen.globalAlpha = 1; }
    if (row === chosen) outline(left, y, size, height);
  }
}
function outline(left, y, size, height) { pen.strokeStyle = colours.cursor; pen.lineWidth = 2; bar(left - 1, y + 2, size + 2, height - 4); pen.stroke(); pen.lineWidth = 1; }
function drawGone(lane, row, y, height) {
  const left = x(row[INITIAL]), isCancelled = row[HOW] === CANCELLED, end = row[END] > row[INITIAL] ? x(row[END]) : left + 28;
  const size = Math.max(12, Math.min(end - left, isCancelled ? 60 : Infinity)), middle = y + height / 2;
  if (isCancelled) {
    bar(left + 0.5, middle - 5.5, size, 11); pen.fillStyle = colours.ground; pen.fill();
    pen.strokeStyle = colours.dim; pen.stroke(); stroke(left - 3, middle, left + size + 4, middle);
  } else { pen.globalAlpha = 0.28; pen.fillStyle = colours[tone(lane, row)]; bar(left, y + 4, size, height - 8); pen.fill(); pen.globalAlpha = 1; }
  if (row === chosen) outline(left, y, size, height);
}

function drawNumber(lane, y, height, width) {
  const low = lane.low, room = lane.high - low || 1, at = (value) => y + height - 7 - ((value - low) / room) * (height - 14);
  const found = pieces(lane, belief), first = firstAfter(found, view[0]), line = new Path2D(), area = new Path2D();
  let before = null, last = -Infinity;
  for (let index = first; index < found.length && found[index][0] <= view[1]; index += 1) {
    const [start, end, row] = found[index], from = Math.max(start, timeAt(LABELS - 9)), to = Math.min(end, timeAt(width + 9));
    const left = x(from), right = x(to), y1 = at(number(row, from)), y2 = at(number(row, to));
    if (before === start && right - last < 0.4) { before = end; continue; }
    if (before === start) line.lineTo(left, y1); else line.moveTo(left, y1);
    line.lineTo(right, y2); before = end; last = right;
    area.moveTo(left, y + height - 4); area.lineTo(left, y1); area.lineTo(right, y2); area.lineTo(right, y + height - 4);
    if (row === chosen) outline(left, y, right - left, height);
  }
  pen.fillStyle = colours.number; pen.globalAlpha = 0.12; pen.fill(area); pen.globalAlpha = 1;
  const edge = Math.max(LABELS, Math.min(width, x(timeOf(belief))));
  pen.strokeStyle = colours.number; pen.lineWidth = 1.8; pen.lineJoin = "round";
  within(LABELS, y, edge, y + height, () => pen.stroke(line));
  within(edge, y, width, y + height, () => { pen.setLineDash([5, 4]); pen.stroke(line); });
  pen.lineWidth = 1;
}

const runEnd = (run) => (isRunning(run, belief) ? Math.max(run.expected, timeOf(belief)) : run.ended);
function drawRun(run, y, height) {
  const isOpen = isRunning(run, belief), end = runEnd(run), left = x(run.started), size = Math.max(2.5, x(end) - left), name = run.outcome === "aborted" && !isOpen ? "bad" : "run";
  bar(left + 0.5, y + 4.5, size - 1, height - 9);
  if (isOpen) {
    pen.globalAlpha = 0.3; pen.fillStyle = colours.run; pen.fill(); pen.globalAlpha = 1;
    within(left, y, x(Math.min(end, timeOf(belief))), y + height, () => { bar(left + 0.5, y + 4.5, size - 1, height - 9); pen.fillStyle = colours.run; pen.fill(); });
    pen.strokeStyle = colours.run; bar(left + 0.5, y + 4.5, size - 1, height - 9); pen.setLineDash([4, 3]); pen.stroke(); pen.setLineDash([]);
  } else { pen.fillStyle = colours[name]; pen.fill(); }
  pen.fillStyle = colours.bad;
  if (end > run.expected) pen.fillRect(x(run.expected), y + height - 4, Math.max(2, x(end) - x(run.expected)), 3);
  for (const [, since, until] of run.broken) if (since < timeOf(belief)) pen.fillRect(x(since), y + 1, Math.max(3, x(Math.min(until ?? end, end)) - x(since)), 3);
  const text = span(end - run.started);
  if (size > pen.measureText(text).width + 10) { pen.fillStyle = isOpen ? colours.ink : colours.ground; pen.fillText(text, Math.max(left, LABELS) + 6, y + height / 2 + 0.5); }
  if (run === chosen) outline(left, y, size, height);
}

function drawTicks(width, height) {
  pen.fillStyle = colours.panel; pen.fillRect(0, 0, width, TICKS);
  const steps = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 5e9, 15e9, 30e9, 60e9, 300e9, 900e9, 3600e9, 4 * 3600e9, 86400e9, 7 * 86400e9, 30 * 86400e9];
  const step = steps.find((each) => (each / (view[1] - view[0])) * (width - LABELS) > (each < 1e9 ? 130 : 84)) ?? 365 * 86400e9;
  const offset = Number(origin % BigInt(step)), isDay = step >= 86400e9;
  for (let t = Math.ceil((view[0] + offset) / step) * step - offset; t <= view[1]; t += step) {
    pen.strokeStyle = colours.line; stroke(x(t), 20, x(t), height);
    pen.fillStyle = colours.dim; pen.fillText(isDay ? clock(t).slice(0, 10) : clock(t).slice(11), x(t) + 4, 12);
  }
  let last = -Infinity;
  for (const [n, time] of data.transactions) {
    const px = x(time);
    if (px < LABELS - 4 || px > width || px - last < 1) continue;
    last = px;
    const isChosen = chosen?.[0] === n && chosen === transactions.get(n);
    pen.globalAlpha = n > belief ? 0.3 : 1; pen.fillStyle = isChosen ? colours.cursor : colours.dim;
    bar(px - 1.5, TICKS - 17, 3, 12); pen.fill(); pen.globalAlpha = 1;
  }
  pen.fillStyle = colours.panel; pen.fillRect(0, 0, LABELS - 6, TICKS); pen.fillStyle = colours.dim;
  pen.fillText(`${clock(view[0] > 0 ? view[0] : 0).slice(0, 10)} ${utc ? "UTC" : "local time"}`, 8, 12); pen.fillText("transactions", 8, TICKS - 11);
  pen.strokeStyle = colours.line; stroke(0, TICKS - 0.5, width, TICKS - 0.5);
}

function drawLines(width, height) {
  const edge = x(timeOf(belief)), at = x(cursor), size = (text) => pen.measureText(text).width + 12;
  const flag = (left, text, colour) => { pen.fillStyle = colour; bar(left, 3, size(text), 18); pen.fill(); pen.fillStyle = colours.ground; pen.fillText(text, left + 6, 12.5); };
  const isSeen = (px) => px >= LABELS && px <= width, time = clock(cursor).slice(11, 23);
  const left = Math.max(LABELS, Math.min(at - size(time) / 2, width - size(time)));
  if (isSeen(edge)) {
    const text = belief > data.latest ? "now" : "as of", half = size(text) / 2, isNear = isSeen(at) && Math.abs(edge - at) < half + size(time) / 2 + 4;
    pen.setLineDash([5, 4]); pen.strokeStyle = colours.goal; stroke(edge, 20, edge, height); pen.setLineDash([]);
    flag(!isNear ? Math.max(LABELS, Math.min(edge - half, width - 2 * half)) : at >= edge && left - 2 * half > LABELS ? left - 2 * half - 2 : left + size(time) + 2, text, colours.goal);
  }
  if (!isSeen(at)) return;
  pen.strokeStyle = colours.cursor; pen.lineWidth = 1.5; stroke(at, 20, at, height); pen.lineWidth = 1;
  flag(left, time, colours.cursor);
}

// -- beside the lanes -----------------------------------------------------------------------------------------

function element(tag, text, name) { const made = document.createElement(tag); made.textContent = text; if (name) made.className = name; return made; }
const MOST = 200;      // lines beside the lanes; a search shows the others
function describe() {
  byId("at").textContent = `${clock(cursor)} ${utc ? "UTC" : "local"}`;
  byId("asofText").textContent = belief > data.latest ? "now: all that is known" : belief ? who(belief) : "before all transactions";
  byId("asofText").title = byId("asofText").textContent;
  byId("notice").hidden = !(cursor > timeOf(belief) && belief < data.known_from && lanes.some((lane) => lane.runs.some((run) => isRunning(run, belief))));
  byId("notice").textContent = `What was expected of the actions that ran is computed from transaction #${data.known_from} on; here only what was recorded is shown.`;
  const parts = [];
  let count = 0;
  for (const [group, shown] of asked) {
    const lines = group.kind === "run" ? shown.filter((lane) => lane.runs.some((run) => run.from <= belief && run.started <= cursor && cursor < runEnd(run))).map((lane) => element("code", lane.text))
      : shown.map((lane) => [lane, standing(lane, cursor, belief)]).filter(([lane, row]) => row && said(lane, row, cursor)).map(([lane, row]) => (count < MOST ? element("code", said(lane, row, cursor), row[VALUE] === 0 && lane.group.kind !== "number" ? "false" : "") : null));
    count += lines.length;
    if (lines.length && lines[0]) parts.push(element("h3", group.kind === "run" ? "running" : group.name), ...lines.filter(Boolean));
  }
  if (count > MOST) parts.push(element("p", `and ${count - MOST} more: search for them`, "dim"));
  byId("state").replaceChildren(...(count ? parts : [element("p", "Nothing holds.", "dim")]));
}

function who(n) { const tx = transactions.get(n); return tx ? `#${n} at ${short(tx[1])}${tx[2] ? ` by ${tx[2]}` : ""}${tx[3] ? `: ${tx[3]}` : ""}` : `#${n}`; }
function explain(lane, row) {
  const lines = [];
  if (row?.started !== undefined) {
    const isOpen = isRunning(row, belief), end = isOpen ? timeOf(belief) : row.ended;
    lines.push(lane.label, `${isOpen ? "running" : row.outcome}: from ${short(row.started)}, for ${span(end - row.started)} (expected: ${span(row.expected - row.started)})`, `started by ${who(row.from)}`);
    if (!isOpen) lines.push(`${row.outcome} by ${who(row.gone)}`);
    if (end > row.expected) lines.push(`overdue by ${span(end - row.expected)}`);
    for (const [condition, since, until] of row.broken) lines.push(`invariant broken: ${condition}, from ${short(since)} ${until === null ? "on" : `until ${short(until)}`}`);
  } else if (lane && row) {
    const end = pieces(lane, belief).find((piece) => piece[2] === row)?.[1] ?? row[END] ?? Infinity, isGone = row[GONE] && row[GONE] <= belief;
    const rate = lane.group.kind === "number" && row[RATE] ? ` ${row[RATE] > 0 ? "+" : "-"} ${Math.abs(row[RATE])} each second` : "";
    lines.push((lane.group.kind === "goal" ? "goal " : "") + (said(lane, row, row[INITIAL]) ?? `(not ${lane.label} - ${row[RATE]})`) + rate, `from ${short(row[INITIAL])} ${end === Infinity ? "on" : `until ${short(end)}, for ${span(end - row[INITIAL])}`}`);
    if (lane.expected.includes(row)) lines.push(`expected of the actions that ran, ${belief > data.latest ? "now" : `as of #${belief}`}; not recorded`);
    else lines.push(`recorded by ${who(row[FROM])}${row[INITIAL] > timeOf(row[FROM]) ? `, ${span(row[INITIAL] - timeOf(row[FROM]))} ahead` : row[INITIAL] < timeOf(row[FROM]) ? `, ${span(timeOf(row[FROM]) - row[INITIAL])} late` : ""}`);
    if (isGone) lines.push(`${row[HOW] === CANCELLED ? "cancelled" : "superseded"} by ${who(row[GONE])}`);
    else if (row[ENDED] && row[ENDED] <= belief) lines.push(timeOf(row[ENDED]) === row[END] ? `ended by ${who(row[ENDED])}` : `ended by the clock, as recorded by ${who(row[ENDED])}`);
    for (const [start, until] of lane.reached) lines.push(`reached at ${short(start)}${until === null ? "" : `, until ${short(until)}`}`);
  } else if (row) lines.push(who(row[0]));
  byId("explain").replaceChildren(...lines.map((text, index) => element("p", text, index ? "dim" : "")));
}

function hit(px, py) {
  if (py < TICKS) {
    const near = data.transactions.reduce((best, tx) => (best && Math.abs(x(best[1]) - px) <= Math.abs(x(tx[1]) - px) ? best : tx), null);
    return { row: near && Math.abs(x(near[1]) - px) < 8 ? near : null };
  }
  const line = visible.find((each) => py + scroll >= each.y && py + scroll < each.y + each.height);
  if (!line || line.group) return { group: line?.group };
  const t = timeAt(px), lane = line.lane, slack = timeAt(4) - timeAt(0);
  if (lane.group.kind === "run") return { lane, row: lane.runs.findLast((run) => run.from <= belief && run.started - slack <= t && t < runEnd(run) + slack) };
  const isHere = (row) => row[INITIAL] - slack <= t && t < Math.max(row[END] ?? Infinity, row[INITIAL]) + 4 * slack;
  const gone = lane.rows.filter((row) => row[GONE] && row[GONE] <= belief && isHere(row) && (row[HOW] !== CANCELLED || px < x(row[INITIAL]) + 60));
  return { lane, row: gone.find((row) => row[HOW] === CANCELLED) ?? standing(lane, t, belief) ?? standing(lane, t + slack, belief) ?? gone[0] };
}

// -- hands ----------------------------------------------------------------------------------------------------

let queued = false, remembering = null;
function redraw() { if (!queued) { queued = true; requestAnimationFrame(() => { queued = false; draw(); }); } }
function remember() {
  clearTimeout(remembering);
  remembering = setTimeout(() => history.replaceState(null, "", `#t=${origin + BigInt(Math.round(cursor))}&as_of=${belief > data.latest ? "now" : belief}&from=${Math.round(view[0])}&to=${Math.round(view[1])}`), 250);
}
function zoom(factor, about = cursor) {
  const middle = about > view[0] && about < view[1] ? about : (view[0] + view[1]) / 2, size = (view[1] - view[0]) * factor;
  if (size < 200 || size > (data.until + 1e9) * 20) return;
  view = [middle - (middle - view[0]) * factor, middle + (view[1] - middle) * factor]; redraw();
}
function fit() { const margin = data.until * 0.015 || 1e9; view = [-margin, data.until + margin]; redraw(); }
function pan(part) { const by = (view[1] - view[0]) * part; view = [view[0] + by, view[1] + by]; redraw(); }
function setBelief(n) { belief = Math.max(data.base, Math.min(NOW, n)); byId("asof").value = belief; redraw(); }
function fold() { const all = closed.size < groups.length; for (const group of groups) if (all) closed.add(group); else closed.delete(group); changed += 1; redraw(); }
function search(text) { byId("search").value = text; wanted = text.toLowerCase().split(/[\s()]+/).filter(Boolean); redraw(); }
function step(by) {
  const times = data.transactions.map((tx) => tx[1]), next = by > 0 ? times.find((t) => t > cursor) : times.findLast((t) => t < cursor);
  if (next === undefined) return;
  cursor = next;
  if (cursor < view[0] || cursor > view[1]) pan((cursor - (view[0] + view[1]) / 2) / (view[1] - view[0]));
}

let dragging = null;
canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); dragging = { px: event.offsetX, py: event.offsetY, view: [...view], scroll, moved: false }; });
canvas.addEventListener("pointermove", (event) => {
  if (!dragging) { canvas.title = hit(event.offsetX, event.offsetY).lane?.text ?? ""; return; }
  const dx = event.offsetX - dragging.px, dy = event.offsetY - dragging.py;
  if (Math.abs(dx) + Math.abs(dy) > 4) dragging.moved = true;
  if (!dragging.moved) return;
  const by = (dx / (canvas.clientWidth - LABELS)) * (dragging.view[1] - dragging.view[0]);
  view = [dragging.view[0] - by, dragging.view[1] - by]; scroll = dragging.scroll - dy; redraw();
});
canvas.addEventListener("pointerup", (event) => {
  const moved = dragging?.moved; dragging = null;
  if (moved) return;
  const { group, lane, row } = hit(event.offsetX, event.offsetY);
  if (group) { if (!closed.delete(group)) closed.add(group); changed += 1; return redraw(); }
  if (event.offsetX >= LABELS) cursor = !lane && row ? row[1] : rounded(timeAt(event.offsetX));
  chosen = row ?? null; changed += 1; explain(lane, chosen); redraw();
});
canvas.addEventListener("pointercancel", () => { dragging = null; });
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (event.ctrlKey || event.metaKey || event.altKey) return zoom(Math.exp(event.deltaY / 300), timeAt(event.offsetX));
  if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) return pan((event.deltaX || event.deltaY) / 900);
  scroll += event.deltaY; redraw();
}, { passive: false });
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || (event.target.tagName === "INPUT" && event.key !== "Escape")) return;
  const by = (view[1] - view[0]) / (event.shiftKey ? 20 : 200);
  const actions = {
    ArrowLeft: () => { cursor -= by; }, ArrowRight: () => { cursor += by; }, ArrowUp: () => { scroll -= 40; }, ArrowDown: () => { scroll += 40; },
    ",": () => step(-1), ".": () => step(1), "+": () => zoom(0.7), "=": () => zoom(0.7), "-": () => zoom(1.4), 0: fit, "[": () => setBelief(belief - 1), "]": () => setBelief(belief + 1),
    "/": () => byId("search").focus(), a: fold, u: () => byId("zone").click(), Escape: () => { search(""); chosen = null; changed += 1; explain(); canvas.focus(); },
  };
  if (!Object.hasOwn(actions, event.key)) return;
  event.preventDefault(); actions[event.key](); cursor = Math.round(cursor); redraw();
});
byId("search").addEventListener("input", (event) => search(event.target.value));
byId("asof").addEventListener("input", (event) => setBelief(Number(event.target.value)));
byId("in").addEventListener("click", () => zoom(0.6));
byId("out").addEventListener("click", () => zoom(1 / 0.6));
byId("fit").addEventListener("click", fit);
byId("fold").addEventListener("click", fold);
byId("zone").addEventListener("click", (event) => { utc = !utc; event.target.textContent = utc ? "UTC" : "Local"; redraw(); });
window.addEventListener("resize", redraw);
// On paper nobody scrolls: all lanes are there.
for (const media of ["(prefers-color-scheme: dark)", "print"]) matchMedia(media).addEventListener("change", () => { const last = visible.at(-1); canvas.style.height = matchMedia("print").matches && last ? `${Math.min(8000, last.y + last.height + 12)}px` : ""; takeColours(); draw(); });
window.addEventListener("hashchange", () => { obey(); redraw(); });

// A link carries the view: the cursor's time (as nanoseconds), the belief and the span.
function obey() {
  const asked = new URLSearchParams(location.hash.slice(1)), whole = (name) => (/^\d{1,19}$/.test(asked.get(name) ?? "") ? asked.get(name) : null);
  if (whole("t")) cursor = Number(BigInt(whole("t")) - origin);
  if (asked.has("as_of")) setBelief(Number(whole("as_of") ?? NOW));
  const from = parseFloat(asked.get("from")), to = parseFloat(asked.get("to"));
  if (to > from) view = [from, to];
}

absorb(JSON.parse(byId("data").textContent)); takeColours(); fit(); cursor = Math.max(0, Math.min(data.now, data.until)); setBelief(data.as_of ?? NOW); obey();
draw();
