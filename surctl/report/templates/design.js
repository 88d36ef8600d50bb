"use strict";
const about = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const start = Object.fromEntries(about.sliders.map((one) => [one.name, one.value]));
let values = { ...start }, compared = null, past = [], future = [], fresh = 0;
const busy = {}, next = {}, timers = {};

for (const one of about.sliders) {
  const box = document.createElement("div"), id = `gain-${one.name}`;
  box.className = "slider";
  const label = document.createElement("label"), name = document.createElement("b"), line = document.createElement("div");
  label.htmlFor = id;
  name.textContent = one.name;
  label.append(name, ` [${one.unit}] ${one.meaning}`);
  line.className = "line";
  const range = document.createElement("input"), number = document.createElement("input");
  Object.assign(range, { type: "range", id, min: 0, max: one.positions.length - 1, step: 1 });
  Object.assign(number, { type: "number", id: `${id}-value`, step: "any", min: one.positions[0], max: one.positions.at(-1) });
  number.setAttribute("aria-label", `${one.name} [${one.unit}]`);
  range.addEventListener("input", () => { values[one.name] = one.positions[range.value]; show(); ask(); });
  range.addEventListener("change", remember);
  number.addEventListener("change", () => {
    const typed = Number(number.value), low = one.positions[0], high = one.positions.at(-1);
    if (number.value !== "" && Number.isFinite(typed)) values[one.name] = Math.min(Math.max(typed, low), high);
    show(); remember(); ask();
  });
  line.append(range, number);
  box.append(label, line);
  $("sliders").append(box);
  one.show = () => {
    const value = values[one.name];
    const near = one.positions.reduce((best, at, k) => Math.abs(at - value) < Math.abs(one.positions[best] - value) ? k : best, 0);
    range.value = near;
    range.setAttribute("aria-valuetext", `${Number(value.toPrecision(4))} ${one.unit}`);
    number.value = Number(value.toPrecision(5));
  };
}
let saved = { ...values };
const same = (a, b) => a !== null && b !== null && Object.keys(a).every((name) => a[name] === b[name]);
function show() {
  about.sliders.forEach((one) => one.show());
  $("undo").disabled = !past.length;
  $("redo").disabled = !future.length;
  $("swap").disabled = $("drop").disabled = compared === null;
  $("compared").textContent = compared === null ? "" :
    "B: " + about.sliders.filter((one) => compared[one.name] !== values[one.name])
      .map((one) => `${one.name} = ${Number(compared[one.name].toPrecision(4))}`).join(", ");
}
function remember() {
  if (same(saved, values)) return;
  past.push(saved);
  future = [];
  saved = { ...values };
  show();
}
function set(to) { values = { ...to }; saved = { ...to }; show(); ask(); }
function undo() { if (past.length) { future.push({ ...saved }); set(past.pop()); } }
function redo() { if (future.length) { past.push({ ...saved }); set(future.pop()); } }

// `view`: an error of a view, which the next good view removes; other messages stay until the next one
function message(text, bad, view = false) {
  $("message").textContent = text; $("message").className = bad ? "bad" : "good"; $("message").dataset.view = `${view}`;
}
async function post(path, body) {
  const response = await fetch(path, { method: "POST", body: JSON.stringify(body),
    headers: { "Content-Type": "application/json", "X-Token": about.token } });
  if (!response.ok) throw new Error(`the server answered ${response.status}; start the page again`);
  return response.json();
}
function request() {
  const points = [...document.querySelectorAll("input[name=point]:checked")].map((box) => box.value);
  return { values, compared, points, opening: $("opening").value, source: $("source").value, end: $("end").value,
    locus: $("gain").value };
}
// one request of a kind at a time; of those that wait, only the last one is sent
async function send(path, place) {
  if (busy[path]) { next[path] = place; return; }
  busy[path] = true;
  const began = performance.now(), version = fresh;
  try {
    const found = await post(path, request());
    if (found.error) message(`error: ${found.error}`, true, true);
    else { place(found); if ($("message").dataset.view === "true") message("", false); }
  } catch (error) { message(`error: ${error.message}`, true, true); }
  busy[path] = false;
  document.body.dataset[path] = `${version}`;
  document.body.dataset[`${path}Ms`] = `${Math.round(performance.now() - began)}`;
  if (next[path]) { const then = next[path]; next[path] = null; send(path, then); }
}
const marked = {}; // goals of the loops and of the runs, which stay in view
function strip(path, html) { marked[path] = html; $("strip").innerHTML = `${marked.goals ?? ""}${marked.run ?? ""}`; }
function later(path, wait, place) { clearTimeout(timers[path]); timers[path] = setTimeout(() => send(path, place), wait); }
function loops() {
  send("linear", (found) => { $("linear").innerHTML = found.html; });
  if (about.goals) later("goals", 30, (found) => { $("goals").innerHTML = found.html; strip("goals", found.strip); });
  later("details", 200, (found) => { $("margins").innerHTML = found.margins; $("locus").innerHTML = found.locus; });
}
function ask() {
  fresh += 1;
  loops();
  later("run", 350, (found) => {
    $("figures").innerHTML = found.table;
    strip("run", found.strip);
    $("run").innerHTML = found.html;
    if (found.moved) loops(); // the loops are about the motion of this run
  });
  $("proofs").textContent = "";
}
$("goals-section").hidden = !about.goals;
$("undo").addEventListener("click", undo);
$("redo").addEventListener("click", redo);
$("reset").addEventListener("click", () => { values = { ...start }; remember(); show(); ask(); });
$("keep").addEventListener("click", () => { compared = { ...values }; show(); ask(); });
$("swap").addEventListener("click", () => { const other = compared; compared = { ...values }; values = { ...other }; remember(); show(); ask(); });
$("drop").addEventListener("click", () => { compared = null; show(); ask(); });
$("save").addEventListener("click", async () => {
  try {
    const found = await post("save", { values, file: $("file").value });
    message(found.error ? `error: ${found.error}` : found.message, Boolean(found.error));
  } catch (error) { message(`error: ${error.message}`, true); }
});
$("load").addEventListener("click", async () => {
  try {
    const found = await post("load", { file: $("file").value });
    if (found.error) { message(`error: ${found.error}`, true); return; }
    values = { ...values, ...found.values }; remember(); show(); ask(); message(found.message, false);
  } catch (error) { message(`error: ${error.message}`, true); }
});
$("slow").addEventListener("click", async () => {
  $("slow").disabled = true;
  $("proofs").textContent = "Working …";
  const version = fresh;
  try {
    const found = await post("slow", request());
    if (version === fresh) { if (found.error) $("proofs").textContent = `error: ${found.error}`; else $("proofs").innerHTML = found.html; }
  } catch (error) { $("proofs").textContent = `error: ${error.message}`; }
  $("slow").disabled = false;
});
for (const id of ["opening", "source", "end", "gain"]) $(id).addEventListener("change", ask);
document.querySelectorAll("input[name=point]").forEach((box) => box.addEventListener("change", ask));
$("controls").addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.target.type === "text" || event.target.type === "number") return;
  const key = event.key.toLowerCase();
  if (key === "z" && !event.shiftKey) { event.preventDefault(); undo(); }
  else if (key === "y" || (key === "z" && event.shiftKey)) { event.preventDefault(); redo(); }
});
show();
ask();
