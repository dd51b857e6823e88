// @ts-check
/** The page for inspecting a running model: an opened or dropped file, or a scene of the benchmark. */
import { fromLetters } from "./actions.js";
import { addressOf, parseAddress } from "./address.js";
import { readTexts } from "./comments.js";
import { onChoice, sceneIdOf, showAddress, showChoice } from "./choice.js";
import { Controls } from "./controls.js";
import { writeScene } from "./scenefile.js";
import { loadMujoco, onProgress } from "./mujoco.js";
import { Plots } from "./plots.js";
import { download } from "./recording.js";
import { edit, editedModel, linkedScene } from "./edited.js";
import { fetchJson, loadEnvironment } from "./scenes.js";
import { addressesOf, sceneAt } from "./simulation.js";
import { FlatStage } from "./flat.js";
import { Stage } from "./stage.js";
import { InspectedModel } from "./inspected.js";

const RATE = 8;  // actions a second
const REST = 250;  // milliseconds without movement before the picture is drawn in full quality
const SLOW = 60;  // milliseconds between pictures
const LATE = 0.25;  // seconds: a longer delay is not caught up
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));
/** @type {Stage | FlatStage} */
let stage;
const plots = new Plots(element("plot"), element("plotted"));
const controls = new Controls(element("solids"), document.querySelectorAll("[data-command]"));

/** The current state of the page. */
const shown = {
  /** @type {InspectedModel | null} */ inspected: null,
  name: "", text: "", running: false, stale: true, behind: 0, last: 0, selected: -1,
  /** @type {(number | number[])[] | null} actions of the expert */ script: null,
  /** @type {string | number[][]} the known actions of the expert, as letters or speeds */ expert: "",
  done: 0, driven: false, turned: -Infinity, rough: false,
  /** @type {import("./address.js").SceneId | null} the scene of the benchmark, if it is one */ sceneId: null,
  address: "",
  /** @type {import("./scene.js").Scene | null} the initial scene of the model, if the page can draw it */ initial: null, editing: false,
};
let choices = 0;  // only the last choice is shown, in whatever order they are loaded

/** @param {string} what @param {boolean} isWrong */
function say(what, isWrong = false) {
  const message = element("message");
  element("download").hidden = true;
  message.textContent = what;
  message.classList.toggle("wrong", isWrong);
}

/**
 * Opens a model. If that fails, the previous one stays, with its address.
 * @param {string} name
 * @param {string} address  with "#"
 * @param {() => Promise<{text: string, sceneId: import("./address.js").SceneId | null, files?: Map<string, Uint8Array>, isFlat?: boolean, expert?: string | number[][]}>} read
 * @param {boolean} [isNew]  whether to add an entry to the browser's history
 */
async function open(name, address, read, isNew = false) {
  const choice = ++choices;
  try {
    const [mujoco, { text, sceneId, files, isFlat, expert }] = await Promise.all([loadMujoco(), read()]);
    if (choice !== choices) return;
    const inspected = new InspectedModel(mujoco, text, files, isFlat);
    shown.inspected?.close();
    Object.assign(shown, { turned: shown.last, inspected, name, text, sceneId, address, expert: expert ?? "", script: null, done: 0, driven: false, behind: 0 });
    run(false);
    stage.open(inspected, text);
    showModel(inspected);
    showAddress(address, isNew);
    say("");
  } catch (error) {
    if (choice !== choices) return;
    const text = `${name} cannot be shown.\n${/** @type {Error} */ (error).message}`;
    say(text, true);
    if (shown.inspected) showAddress(shown.address, false);
    else /** @type {any} */ (window).showFailure(text, () => {
      say("Loading …");
      open(name, address, read, isNew);
    });
  }
  showChoice(catalogue, shown.sceneId);
}

/** The scene in a file of the benchmark. Null for other models, and for scenes that this page cannot draw. @param {string} text  MJCF */
function sceneIn(text) {
  try {
    return linkedScene(readTexts(text).scene ?? "", catalogue);
  } catch {
    return null;
  }
}

/** Opens the editor with the current scene. */
function change() {
  const { inspected, initial, sceneId } = shown;
  if (!inspected || !initial) return;
  const { mujoco, model, data } = inspected, known = sceneId ?? parseAddress(`#${readTexts(shown.text).task ?? ""}`, catalogue);
  const now = data.time ? sceneAt(initial, addressesOf(mujoco, model, initial), data.qpos) : initial;
  run(false);
  shown.editing = true;
  edit(catalogue, { ...known, shifts: "" }, now, "Inspect it", (scene) => {
    Object.assign(shown, { editing: false, stale: true });
    if (scene) openScene({ ...known, shifts: "", scene });
    element("solids").focus({ preventScroll: true });
  }).catch((error) => {
    shown.editing = false;
    say(error.message, true);
  });
}

/** @param {InspectedModel} inspected */
function showModel(inspected) {
  shown.initial = sceneIn(shown.text);
  element("edit").hidden = !shown.initial;
  document.title = `${shown.name} · Inspect a model · MAGICAL`;
  for (const id of ["legend", "pad"]) element(id).hidden = !inspected.acts;
  element("expert").hidden = !shown.expert.length;
  element("model").href = `data:text/xml;charset=utf-8,${encodeURIComponent(shown.text)}`;
  element("model").download = shown.name.endsWith(".xml") ? shown.name : `${shown.name}.xml`;
  element("file-says").hidden = !inspected.comments.file;
  element("file-says").querySelector("pre").textContent = inspected.comments.file;
  element("tree").replaceChildren(...treeOf(inspected));
  element("controls").hidden = !inspected.model.nu;
  element("controls").querySelector("div").replaceChildren(...slidersOf(inspected));
  plots.open(inspected);
  select(-1);
}

/** A button for each body, below that of its parent. @param {InspectedModel} inspected */
function treeOf(inspected) {
  const { model } = inspected, depths = [0];
  return Array.from({ length: model.nbody }, (_, body) => {
    if (body) depths[body] = depths[model.body_parentid[body]] + 1;
    const button = document.createElement("button");
    button.textContent = inspected.label(body);
    button.style.setProperty("--depth", String(depths[body]));
    button.onclick = () => select(body);
    return button;
  });
}

/** @param {InspectedModel} inspected */
function slidersOf(inspected) {
  const { model } = inspected;
  return inspected.names("actuator", "actuator", model.nu).map((name, id) => {
    const label = document.createElement("label"), slider = document.createElement("input"), value = document.createElement("output");
    const range = model.actuator_ctrlrange.subarray(2 * id, 2 * id + 2);  // 0 0: unlimited; MuJoCo's build gives no flags
    const [low, high] = range[0] < range[1] ? range : [-inspected.most[id], inspected.most[id]];
    Object.assign(slider, { type: "range", min: low, max: high, step: (high - low) / 200 || 1 });
    slider.oninput = () => {
      shown.driven = false;
      shown.script = null;
      inspected.data.ctrl[id] = Number(slider.value);
      value.textContent = Number(slider.value).toFixed(2);
    };
    label.append(name, slider, value);
    return label;
  });
}

function showSliders() {
  const { ctrl } = /** @type {InspectedModel} */ (shown.inspected).data;
  element("controls").querySelectorAll("label").forEach((/** @type {HTMLElement} */ label, /** @type {number} */ id) => {
    const [slider, value] = /** @type {any} */ (label.querySelectorAll("input, output"));
    if (document.activeElement !== slider) slider.value = String(ctrl[id]);
    value.textContent = ctrl[id].toFixed(2);
  });
}

/** @param {number} body  -1: none */
function select(body) {
  shown.selected = body;
  shown.stale = true;
  stage.select(body);
  [...element("tree").children].forEach((button, i) => { button.ariaCurrent = String(i === body); });
  const tree = element("tree"), chosen = tree.children[body];
  if (chosen && (chosen.offsetTop < tree.scrollTop || chosen.offsetTop > tree.scrollTop + tree.clientHeight - 30)) tree.scrollTop = chosen.offsetTop - 60;
  describe();
}

/** Updates the description of the selected body. */
function describe() {
  const about = element("about"), inspected = /** @type {InspectedModel} */ (shown.inspected);
  if (shown.selected < 0) {
    const { nbody, njnt, ngeom, nu } = inspected.model;
    about.replaceChildren(tag("h2", shown.name), tag("p", `${nbody} bodies, ${njnt} joints, ${ngeom} geoms, ${nu} actuators. Click a body to learn about it.`));
    return;
  }
  const { name, about: words, facts, joints, geoms } = inspected.describe(shown.selected);
  about.replaceChildren(tag("h2", name), ...words ? [tag("p", words)] : [], table("facts", [], facts),
    ...joints.length ? [tag("h3", `Joints: ${joints.length}`), table("list", ["Name", "Type", "Position", "Velocity", "Range", "Damping", "Dry friction"], joints)] : [],
    ...geoms.length ? [tag("h3", `Geoms: ${geoms.length}`), table("list", ["Name", "Type", "Size", "Group", "Friction", "Contype / affinity", "What it is"], geoms)] : []);
}

/** @param {string} name @param {string} text */
function tag(name, text) {
  const one = document.createElement(name);
  one.textContent = text;
  return one;
}

/** @param {string} kind @param {string[]} header @param {string[][]} rows */
function table(kind, header, rows) {
  const box = document.createElement("div"), all = document.createElement("table");
  box.className = "scroll";
  box.tabIndex = 0;
  all.className = kind;
  const row = (/** @type {string[]} */ cells, /** @type {(i: number) => string} */ kindOf) => {
    const line = document.createElement("tr");
    line.append(...cells.map((cell, i) => tag(kindOf(i), cell)));
    return line;
  };
  if (header.length) all.createTHead().append(row(header, () => "th"));
  const body = all.createTBody();
  body.append(...rows.map((cells) => row(cells, (i) => kind === "facts" && i === 0 ? "th" : "td")));
  box.append(all);
  return box;
}

/** @param {boolean} running */
function run(running) {
  shown.running = running;
  shown.last = performance.now();
  shown.behind = 0;
  element("run").firstChild.textContent = running ? "Pause " : "Run ";
}

/** The smallest step: an action of the benchmark, or a step of MuJoCo for other models. */
function step() {
  const inspected = /** @type {InspectedModel} */ (shown.inspected);
  shown.stale = true;
  if (!inspected.acts) inspected.step();
  else if (shown.script) inspected.act(shown.script[shown.done++] ?? 0);
  else if (controls.touched || shown.driven) {
    shown.driven = true;
    inspected.act(controls.next());
  } else for (let i = 0; i < inspected.substeps; i++) inspected.step();
  inspected.update();
  plots.note();
}

let pace = 0;  // milliseconds between pictures while something moves

/** @param {number} time  milliseconds */
function frame(time) {
  const { inspected } = shown;
  if (inspected && !shown.editing) {
    if (!shown.running && inspected.acts && controls.touched) run(true);
    if (shown.running) {
      const period = inspected.acts ? 1 / RATE : inspected.model.opt.timestep, speed = Number(element("speed").value);
      shown.behind = Math.min(LATE, shown.behind + (time - shown.last) / 1000);
      for (const began = performance.now(); shown.behind * speed >= period && performance.now() - began < 30; shown.behind -= period / speed) step();
      if (shown.script && shown.done >= shown.script.length) run(false);
    }
    const isMoving = shown.running || time - shown.turned < REST;
    if (isMoving) pace = 0.9 * pace + 0.1 * (time - shown.last);
    if (pace > SLOW) stage.slow = true;
    shown.last = time;
    if (shown.stale || (shown.rough && !isMoving)) show(inspected, isMoving);
  }
  requestAnimationFrame(frame);
}

let described = 0;  // when the description was last updated

/** @param {InspectedModel} inspected @param {boolean} isMoving */
function show(inspected, isMoving) {
  shown.stale = false;
  shown.rough = isMoving && stage.slow;
  stage.draw(isMoving);
  element("time").textContent = `${inspected.data.time.toFixed(3)} s`;
  const now = performance.now();
  if (shown.running && now - described < 150) return;
  described = now;
  showSliders();
  if (shown.selected >= 0) describe();
  plots.draw();
}

function reset() {
  Object.assign(shown, { script: null, done: 0, driven: false, stale: true });
  shown.inspected?.reset();
  run(false);
}

/** Plays the expert's actions in this scene. */
function expert() {
  reset();
  shown.script = typeof shown.expert === "string" ? fromLetters(shown.expert) : shown.expert;
  run(true);
}

function state() {
  const inspected = /** @type {InspectedModel} */ (shown.inspected), { model } = inspected;
  const names = { joints: inspected.names("jnt", "joint", model.njnt), actuators: inspected.names("actuator", "actuator", model.nu) };
  return { model: shown.name, ...inspected.state(), ...names };
}

/** Opens dropped or chosen files: one model, and the files that it needs. @param {Iterable<File>} files */
async function openFiles(files) {
  const all = [...files], scenes = all.filter(({ name }) => name.endsWith(".json"));
  if (all.length === 1 && scenes.length === 1) return openSceneFile(scenes[0]);
  const models = all.filter(({ name }) => /\.(xml|mjcf)$/i.test(name));
  const texts = await Promise.all(models.map((file) => file.text()));
  const included = models.filter(({ name }) => texts.some((text) => text.includes(`"${name}"`) || text.includes(`/${name}"`)));
  const main = models.find((file) => !included.includes(file)) ?? models[0];
  if (!main) return say("A model is an .xml file: open it together with the files that it needs.", true);
  const text = texts[models.indexOf(main)];
  reopen = () => open(main.name, "#file", async () => ({
    text,
    sceneId: await offered(text),
    isFlat: true,
    files: new Map(await Promise.all(all.filter((file) => file !== main).map(
      async (file) => /** @type {[string, Uint8Array]} */ ([file.name, new Uint8Array(await file.arrayBuffer())])))),
  }), true);
  await reopen();
}

/** Opens a scene as JSON, as `magical_mj.Scene.to_json` writes it. @param {File} file */
async function openSceneFile(file) {
  const text = await file.text(), known = shown.sceneId ?? parseAddress("", catalogue);
  try {
    await openScene({ ...known, shifts: "", scene: writeScene(linkedScene(text, catalogue)) });
  } catch (error) {
    say(`${file.name} cannot be opened.\n${/** @type {Error} */ (error).message}`, true);
  }
}

/** Opens the files of the visitor again, until the page is left. @type {(() => Promise<void>) | null} */
let reopen = null;

/** @type {any} */
let catalogue = null;

/** The scene in a file, if the page has it. Otherwise null. @param {string} text  MJCF */
async function offered(text) {
  const sceneId = sceneIdOf(readTexts(text), catalogue);
  if (!sceneId || catalogue.simulation === "server") return sceneId;
  const { scenes } = await loadEnvironment(sceneId.task, sceneId.variant, sceneId.shifts);
  return scenes.length === 1 || scenes.some(({ seed }) => seed === sceneId.seed) ? sceneId : null;
}

/** @param {import("./address.js").SceneId} sceneId @param {boolean} [isNew]  whether to add an entry to the browser's history */
async function openScene(sceneId, isNew = true) {
  const { task, variant, seed, shifts, scene } = sceneId, name = addressOf({ ...sceneId, scene: "" });
  if (!shown.inspected) showChoice(catalogue, sceneId);  // the scene that is being loaded
  await open(scene ? `${task}-edited` : name, `#${addressOf(sceneId)}`, async () => {
    if (scene) return { text: await editedModel(catalogue, sceneId, linkedScene(scene, catalogue)), sceneId };
    if (catalogue.simulation === "server") {
      const reply = await fetch(`models/${name}.xml`);
      if (!reply.ok) throw new Error(await reply.text());
      return { text: await reply.text(), sceneId };
    }
    const { scenes, elements = [] } = await loadEnvironment(task, variant, shifts);
    const entry = scenes.length > 1 ? scenes.find((one) => one.seed === seed) : scenes[0];  // all seeds of Demo have one scene
    if (!entry) throw new Error(`This page has the seeds ${scenes[0].seed} to ${scenes[scenes.length - 1].seed}; magical-mj inspect has all seeds.`);
    return { text: (entry.mjcf ?? []).map((i) => elements[i]).join(""), sceneId, expert: entry.expert };
  }, isNew);
}

/** Opens the scene in the address, such as `#FindDupe-All-3`, or the file that the server was given. */
async function openAddress() {
  const { hash } = location, given = catalogue.model;
  if (hash === "#file" && reopen) return reopen();
  if (hash === "#file" && !given) {
    showChoice(catalogue, null);
    return say("The page keeps no files: open the model again, or choose a task.");
  }
  if (given && (!hash || hash === "#file")) {
    return open(given.name, hash, async () => {
      const reply = await Promise.all([given.name, ...given.files].map((_, number) => fetch(`model/${number}`)));
      const contents = await Promise.all(reply.map((one) => one.arrayBuffer()));
      const files = given.files.map((/** @type {string} */ name, /** @type {number} */ i) => [name, new Uint8Array(contents[i + 1])]);
      const text = new TextDecoder().decode(contents[0]);
      return { text, sceneId: await offered(text), files: new Map(files) };
    });
  }
  const { unknown, ...sceneId } = parseAddress(hash, catalogue);
  await openScene(sceneId, false);
  if (unknown) say(unknown, true);
}

/** @type {Record<string, string>} the buttons by key */
const SHORTCUTS = { KeyP: "run", Period: "step", KeyR: "reset", KeyE: "edit" };

function connect() {
  element("run").onclick = () => run(!shown.running);
  element("step").onclick = () => {
    run(false);
    if (shown.inspected) step();
  };
  element("reset").onclick = reset;
  element("edit").onclick = change;
  element("expert").onclick = expert;
  element("picture").onclick = async () => download(`${shown.name}.png`, await stage.picture());
  element("state").onclick = () => download(`${shown.name}-state.json`, new Blob([JSON.stringify(state(), null, 1)], { type: "application/json" }));
  element("copy").onclick = () => navigator.clipboard.writeText(JSON.stringify(state())).then(() => say("The state was copied."), (error) => say(error.message, true));
  element("file").onchange = () => openFiles(element("file").files);
  element("open").onkeydown = (/** @type {KeyboardEvent} */ { key }) => { if (key === "Enter" || key === " ") element("file").click(); };
  element("switches").onchange = (/** @type {any} */ { target }) => {
    if (target.name === "insets") stage.insets = target.checked;
    else stage.shown[/** @type {keyof Stage["shown"]} */ (target.name)] = target.checked;
    shown.stale = true;
  };
  for (const id of ["controls", "sensors"]) element(id).ontoggle = () => { shown.stale = true; };
  onChoice(catalogue, openScene);
  addEventListener("hashchange", openAddress);
  addEventListener("keydown", (event) => {
    const elsewhere = /** @type {any} */ (event.target).matches("select, input");
    if (elsewhere || shown.editing || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    if (SHORTCUTS[event.code]) element(SHORTCUTS[event.code]).click();
  });
  new ResizeObserver(() => { shown.stale = true; }).observe(element("solids"));
  const canvas = element("solids");
  let pressed = [0, 0];
  canvas.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => { pressed = [event.offsetX, event.offsetY]; });
  canvas.addEventListener("pointerup", (/** @type {PointerEvent} */ { offsetX, offsetY }) => {
    if (shown.inspected && Math.hypot(offsetX - pressed[0], offsetY - pressed[1]) < 5) select(stage.bodyAt(offsetX, offsetY));
  });
  const drop = element("stage");
  addEventListener("dragover", (event) => {
    event.preventDefault();
    drop.classList.add("dragged");
  });
  addEventListener("dragleave", () => drop.classList.remove("dragged"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("dragged");
    openFiles(event.dataTransfer?.files ?? []);
  });
}

try {
  onProgress((share) => { element("download").value = share; });
  catalogue = await fetchJson("catalogue.json");
  const isSolid = document.createElement("canvas").getContext("webgl2") !== null;
  const canvas = element("solids");
  stage = isSolid ? new Stage(canvas, () => { Object.assign(shown, { stale: true, turned: shown.last }); }) : new FlatStage(canvas, catalogue.look);
  element("switches").hidden = !isSolid;
  canvas.classList.toggle("flat", !isSolid);
  if (catalogue.simulation === "server") element("home").removeAttribute("href");
  connect();
  requestAnimationFrame(frame);
  const { files } = element("file");  // it may have been chosen before this script was loaded
  await (files.length ? openFiles(files) : openAddress());
  element("poster").remove();
} catch (error) {
  /** @type {any} */ (window).showFailure(/** @type {Error} */ (error).message);
}
