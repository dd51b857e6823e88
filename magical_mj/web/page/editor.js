// @ts-check
/** Changes a scene: a picture from above with a handle for each object, for mouse, touch and keyboard, and fields with exact numbers. */
import { readTexts } from "./comments.js";
import { draw, fitToScreen } from "./draw.js";
import { faults, label } from "./legal.js";
import { download } from "./recording.js";
import { CHOICES, readScene, writeScene } from "./scenefile.js";
import { lack, score } from "./score.js";

/**
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {Record<string, any>} Values  of an object's fields
 * @typedef {{catalogue: any, scene: Scene, task: string, name: string, action: string, address: (scene: string) => string,
 *   model: (scene: Scene) => Promise<string>, done: (scene: string | null) => void}} Options
 *   task: for the score; name: of saved files; action: the label of the button that ends editing; address: of the page with a scene;
 *   model: MJCF; done: called with the scene as JSON, or null if it was not changed
 */
const STEP = 0.02, FINE = 0.002, TURN = Math.PI / 12;  // world units and rad, for a press of a key
const SMALLEST = 0.05;  // side of a region
const MOST = { blocks: 10, regions: 3 };  // state vectors have room for these
/** @type {Record<string, number[]>} */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const CORNERS = [["x_min", "y_max"], ["x_max", "y_max"], ["x_max", "y_min"], ["x_min", "y_min"]];

/** Short numbers for links; numbers that nobody changed keep all digits. @param {number} value */
const short = (value) => Math.round(1000 * value) / 1000;

/** @param {string} tag @param {Values} properties @param {(Node | string)[]} children @returns {any} */
function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

export class Editor {
  /** @type {Scene[]} */ #before = [];
  /** @type {Scene[]} */ #after = [];
  /** @type {string} the selected object: "robot", "block 0", "region 1", "pebble 0", or "" */ #selected = "";
  /** @type {Map<string, HTMLButtonElement>} */ #handles = new Map();

  /** Shows the editor instead of the rest of the page. @param {Options} options */
  constructor(options) {
    this.options = options;
    this.scene = options.scene;
    this.canvas = make("canvas", { width: 480, height: 480 });
    this.ego = make("canvas", { width: 240, height: 240, ariaLabel: "The robot’s view", role: "img" });
    this.board = make("div", { className: "board" }, this.canvas);
    this.fields = make("div", { className: "fields" });
    this.verdict = make("p", { className: "verdict", role: "status" });
    this.file = make("input", { type: "file", accept: ".json,.xml,.mjcf", hidden: true, onchange: () => this.#open(this.file.files[0]) });
    const button = (/** @type {string} */ text, /** @type {() => void} */ onclick, /** @type {Values} */ more = {}) => make("button", { textContent: text, onclick, ...more });
    this.buttons = {
      block: button("+ Block", () => this.#add("blocks")),
      region: button("+ Region", () => this.#add("regions")),
      undo: button("Undo", () => this.#undo(), { ariaKeyShortcuts: "Control+Z" }),
      redo: button("Redo", () => this.#redo(), { ariaKeyShortcuts: "Control+Y" }),
      json: button("Save scene", () => this.#download("json", writeScene(this.scene)), { id: "save-scene" }),
      mjcf: button("Save model", () => this.#saveModel(), { id: "save-model" }),
      link: button("Copy link", () => this.#copyLink()),
      open: button("Open …", () => this.file.click()),
      done: button(options.action, () => this.#close(this.#before.length ? writeScene(this.scene) : null), { className: "main" }),
      cancel: button("Cancel", () => this.#cancel()),
    };
    const { block, region, undo, redo, json, mjcf, link, open, done, cancel } = this.buttons;
    const row = (/** @type {Node[]} */ ...all) => make("div", { className: "row" }, ...all);
    this.root = make("section", { id: "editor", ariaLabel: "Change the scene", onkeydown: (/** @type {KeyboardEvent} */ event) => this.#key(event) },
      this.board, make("div", { className: "panel" },
        make("h1", { textContent: "Change the scene" }),
        make("p", { className: "help", textContent: "Drag what you want to move, and the corners of a region. By keyboard: Tab selects, arrows move (with Shift finely), "
          + "R turns, + and − change the size of a region, Delete removes." }),
        row(block, region, undo, redo), this.fields, this.verdict, row(done, cancel), row(json, mjcf, link, open, this.file), this.ego));
    document.querySelector("main")?.append(this.root);
    document.body.classList.add("editing");
    /** @type {HTMLElement} */ (document.querySelector("header")).inert = true;
    addEventListener("beforeunload", this.#keep);
    addEventListener("hashchange", this.#cancel);  // Back leaves the editor
    fitToScreen([this.canvas, this.ego], () => this.#draw());
    this.#show();
    this.#select("robot");
    this.#handles.get("robot")?.focus({ preventScroll: true });
  }

  #keep = (/** @type {Event} */ event) => { if (this.#before.length) event.preventDefault(); };

  #cancel = () => { if (!this.#before.length || confirm("Leave the changes?")) this.#close(null); };

  /** @param {string | null} scene */
  #close(scene) {
    this.root.remove();
    document.body.classList.remove("editing");
    /** @type {HTMLElement} */ (document.querySelector("header")).inert = false;
    removeEventListener("beforeunload", this.#keep);
    removeEventListener("hashchange", this.#cancel);
    this.options.done(scene);
  }

  /** The names of all objects, from the lowest to the topmost one. */
  get #names() {
    const { regions, blocks, pebbles = [] } = this.scene;
    return [...regions.map((_, i) => `region ${i}`), ...blocks.map((_, i) => `block ${i}`), ...pebbles.map((_, i) => `pebble ${i}`), "robot"];
  }

  /** @param {string} name @returns {any} */
  #object(name) {
    const [kind, index] = name.split(" ");
    return kind === "robot" ? this.scene.robot : /** @type {any} */ (this.scene)[`${kind}s`][Number(index)];
  }

  /** The scene with other fields of an object. @param {string} name @param {Values} values */
  #with(name, values) {
    const object = { ...this.#object(name), ...values }, [kind, index] = name.split(" "), list = `${kind}s`;
    if (kind === "robot") return { ...this.scene, robot: object };
    return { ...this.scene, [list]: /** @type {any} */ (this.scene)[list].map((/** @type {any} */ one, /** @type {number} */ i) => i === Number(index) ? object : one) };
  }

  /** Shows a changed scene, which can be undone. @param {Scene} scene */
  #change(scene) {
    this.#before.push(this.scene);
    this.#after = [];
    this.scene = scene;
    this.#show();
  }

  #undo() {
    this.#travel(this.#before, this.#after);
  }

  #redo() {
    this.#travel(this.#after, this.#before);
  }

  /** @param {Scene[]} from @param {Scene[]} to */
  #travel(from, to) {
    const scene = from.pop();
    if (!scene) return;
    to.push(this.scene);
    this.scene = scene;
    this.#show();
  }

  /** @param {"blocks" | "regions"} list */
  #add(list) {
    const { blocks, half_width: half = 1 } = this.scene, { solids } = this.options.catalogue;
    const mass = blocks[0]?.mass, name = `${list.slice(0, -1)} ${this.scene[list].length}`;
    const made = (/** @type {number} */ x, /** @type {number} */ y) => /** @type {Scene} */ ({ ...this.scene, [list]: [...this.scene[list], list === "blocks"
      ? { shape: "square", colour: "red", x, y, angle: 0, ...mass && { mass } } : { colour: "blue", x_min: short(x - 0.25), y_min: short(y - 0.25), x_max: short(x + 0.25), y_max: short(y + 0.25) }] });
    const places = Array.from({ length: 81 }, (_, i) => [i % 9 - 4, Math.floor(i / 9) - 4].map((steps) => short(0.2 * half * steps)));
    places.sort(([ax, ay], [bx, by]) => Math.hypot(ax, ay) - Math.hypot(bx, by));
    const free = places.find(([x, y]) => !faults(made(x, y), solids).some(({ names }) => names.includes(name))) ?? [0, 0];
    this.#change(made(free[0], free[1]));
    this.#select(name);
    this.#handles.get(name)?.focus({ preventScroll: true });
  }

  /** @param {string} name  not the robot's */
  #remove(name) {
    const [kind, index] = name.split(" "), list = `${kind}s`;
    if (kind === "robot") return;
    const all = /** @type {any} */ (this.scene)[list].filter((/** @type {any} */ _, /** @type {number} */ i) => i !== Number(index));
    const { pebbles, ...rest } = this.scene;
    this.#change(list === "pebbles" && !all.length ? rest : { ...this.scene, [list]: all });
    this.#handles.get(this.#selected)?.focus({ preventScroll: true });
  }

  /** The fields of an object that was moved. @param {any} object @param {number} dx @param {number} dy @returns {Values} */
  #moved(object, dx, dy) {
    const half = this.scene.half_width ?? 1, limited = (/** @type {number} */ value) => short(Math.min(half, Math.max(-half, value)));
    if ("x" in object) return { x: limited(object.x + dx), y: limited(object.y + dy) };
    const { x_min, y_min, x_max, y_max } = object;
    return { x_min: short(x_min + dx), y_min: short(y_min + dy), x_max: short(x_max + dx), y_max: short(y_max + dy) };
  }

  /** A region with one corner elsewhere. @param {any} region @param {string[]} sides  such as x_min and y_max @param {number} dx @param {number} dy @returns {Values} */
  #resized(region, sides, dx, dy) {
    const half = this.scene.half_width ?? 1;
    return Object.fromEntries(sides.map((side, i) => {
      const value = Math.min(half, Math.max(-half, region[side] + (i ? dy : dx))), axis = side[0];
      return [side, short(side.endsWith("min") ? Math.min(value, region[`${axis}_max`] - SMALLEST) : Math.max(value, region[`${axis}_min`] + SMALLEST))];
    }));
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    event.stopPropagation();  // the page has keys of its own
    const { key, shiftKey, target } = event, isField = /** @type {HTMLElement} */ (target).matches("input, select");
    if (isField) return;
    if (event.ctrlKey || event.metaKey) {
      const isBack = key.toLowerCase() === "z" && !shiftKey;
      if (!isBack && !["y", "z"].includes(key.toLowerCase())) return;
      event.preventDefault();
      return isBack ? this.#undo() : this.#redo();
    }
    const name = /** @type {HTMLElement} */ (target).dataset.object;
    if (!name || event.altKey) return;
    const object = this.#object(name), step = shiftKey ? FINE : STEP, grown = key === "-" ? -step : step;
    if (ARROWS[key]) this.#change(this.#with(name, this.#moved(object, ARROWS[key][0] * step, ARROWS[key][1] * step)));
    else if (key.toLowerCase() === "r") this.#turn(shiftKey ? -TURN : TURN);
    else if (["+", "=", "-"].includes(key) && "x_min" in object) this.#change(this.#with(name, this.#resized(object, ["x_max", "y_max"], grown, grown)));
    else if (key === "Delete" || key === "Backspace") this.#remove(name);
    else return;
    event.preventDefault();
  }

  /** Turns the selected object. @param {number} by */
  #turn(by) {
    const object = this.#object(this.#selected);
    if ("angle" in object) this.#change(this.#with(this.#selected, { angle: short(object.angle + by) }));
  }

  /** Drags a handle, or a corner of a region. @param {PointerEvent} event */
  #drag(event) {
    const handle = /** @type {HTMLButtonElement} */ (event.currentTarget), name = handle.dataset.object ?? "";
    const corner = /** @type {HTMLElement} */ (event.target).dataset.corner?.split(" "), before = this.scene, object = this.#object(name);
    const { half_width: half = 1 } = before, perPixel = this.options.catalogue.look.visible * half / this.canvas.clientWidth;
    handle.setPointerCapture(event.pointerId);
    handle.focus({ preventScroll: true });
    const move = (/** @type {PointerEvent} */ { clientX, clientY }) => {
      const dx = (clientX - event.clientX) * perPixel, dy = (event.clientY - clientY) * perPixel;
      if (this.scene === before && Math.hypot(clientX - event.clientX, clientY - event.clientY) < 3) return;  // a tap only selects
      this.scene = this.#with(name, corner ? this.#resized(object, corner, dx, dy) : this.#moved(object, dx, dy));
      this.#show();
    };
    const end = () => {
      for (const kind of ["pointerup", "pointercancel"]) handle.removeEventListener(kind, end);
      handle.removeEventListener("pointermove", move);
      if (this.scene === before) return;
      const { scene } = this;
      this.scene = before;
      this.#change(scene);
    };
    handle.addEventListener("pointermove", move);
    for (const kind of ["pointerup", "pointercancel"]) handle.addEventListener(kind, end);
    event.preventDefault();  // no text is selected, and phones do not scroll
  }

  /** @param {string} name */
  #select(name) {
    this.#selected = name;
    for (const [one, handle] of this.#handles) handle.ariaCurrent = String(one === name);
    const object = this.#object(name), isBody = "angle" in object;
    const inputs = Object.keys(object).filter((key) => key in CHOICES || typeof object[key] === "number").map((key) => make("label", {}, `${key.replace("_", " ")} `, this.#field(name, key)));
    const turn = (/** @type {string} */ text, /** @type {string} */ title, /** @type {number} */ by) => make("button", { textContent: text, ariaLabel: title, title, onclick: () => this.#turn(by) });
    this.fields.replaceChildren(make("h2", { textContent: label(name, true) }), ...inputs,
      ...isBody ? [turn("⟲", "Turn left", TURN), turn("⟳", "Turn right", -TURN)] : [],
      ...name === "robot" ? [] : [make("button", { textContent: "Remove", onclick: () => this.#remove(name) })]);
  }

  /** The field for one of an object's values. @param {string} name @param {string} key */
  #field(name, key) {
    const options = CHOICES[key], value = this.#object(name)[key];
    const field = options ? make("select", {}, ...options.map((one) => new Option(one))) : make("input", { type: "number", step: "any" });
    Object.assign(field, { name: key, value });
    field.onchange = () => {  // Firefox rounds valueAsNumber
      const given = options ? field.value : field.value ? Number(field.value) : null, scene = this.#with(name, { [key]: given });
      try {
        readScene(writeScene(scene), Object.keys(this.options.catalogue.solids.robots));
        this.#change(scene);
      } catch (error) {
        field.value = String(this.#object(name)[key]);
        this.#say(/** @type {Error} */ (error).message, true);
      }
    };
    return field;
  }

  /** Updates everything that depends on the scene. */
  #show() {
    const names = this.#names, wrong = faults(this.scene, this.options.catalogue.solids), { task } = this.options;
    if (names.join() !== [...this.#handles.keys()].join()) this.#makeHandles(names);
    const { visible } = this.options.catalogue.look, { half_width: half = 1 } = this.scene, share = (/** @type {number} */ length) => `${100 * length / (visible * half)}%`;
    const edge = visible * half / 2;
    for (const [name, handle] of this.#handles) {
      const object = this.#object(name), { x_min, y_min, x_max, y_max } = boxOf(name, object);
      Object.assign(handle.style, { left: share(x_min + edge), top: share(edge - y_max), width: share(x_max - x_min), height: share(y_max - y_min) });
      handle.classList.toggle("wrong", wrong.some((fault) => fault.names.includes(name)));
      const [x, y] = [(x_min + x_max) / 2, (y_min + y_max) / 2], look = [object.colour, object.shape].filter(Boolean).join(" ");
      handle.ariaLabel = `${label(name, true)}${look && `, ${look}`}, at ${x.toFixed(2)}, ${y.toFixed(2)}${handle.classList.contains("wrong") ? ", in an illegal place" : ""}`;
    }
    if (!names.includes(this.#selected)) this.#select("robot");
    for (const field of this.fields.querySelectorAll("input, select")) field.value = this.#object(this.#selected)[field.name];
    const need = task && lack(task, this.scene), words = wrong.length ? `${wrong.map((fault) => fault.words).join(". ")}.` : "This scene is legal.";
    this.#say(`${words} ${!task ? "" : need ? `No score: ${task} needs ${need}.` : `Score at the start: ${score(task, this.scene, this.scene).toFixed(2)}`}`, wrong.length > 0);
    for (const one of ["done", "mjcf"]) this.buttons[/** @type {"done" | "mjcf"} */ (one)].disabled = wrong.length > 0;
    this.buttons.undo.disabled = !this.#before.length;
    this.buttons.redo.disabled = !this.#after.length;
    for (const [one, list] of /** @type {const} */ ([["block", "blocks"], ["region", "regions"]])) {
      this.buttons[one].disabled = this.scene[list].length >= MOST[list];
      this.buttons[one].title = this.buttons[one].disabled ? `State vectors have room for ${MOST[list]} ${list}` : "";
    }
    this.#draw();
  }

  /** @param {string[]} names */
  #makeHandles(names) {
    this.#handles = new Map(names.map((name) => {
      const [kind] = name.split(" "), handle = make("button", { className: `handle ${kind}`, onfocus: () => this.#select(name) });
      handle.dataset.object = name;
      handle.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => this.#drag(event));
      if (kind === "region") handle.append(...CORNERS.map((sides) => {
        const corner = make("span", { className: `corner ${sides.join(" ")}` });
        corner.dataset.corner = sides.join(" ");
        return corner;
      }));
      return /** @type {[string, HTMLButtonElement]} */ ([name, handle]);
    }));
    this.board.replaceChildren(this.canvas, ...this.#handles.values());
    for (const [name, handle] of this.#handles) handle.ariaCurrent = String(name === this.#selected);
  }

  #draw() {
    const { look } = this.options.catalogue;
    draw(this.canvas, look, this.scene, "allo");
    draw(this.ego, look, this.scene, "ego");
  }

  /** @param {string} text @param {boolean} [isWrong] */
  #say(text, isWrong = false) {
    if (this.verdict.textContent !== text) this.verdict.textContent = text;
    this.verdict.classList.toggle("wrong", isWrong);
  }

  /** @param {string} ending @param {string} text */
  #download(ending, text) {
    download(`${this.options.name}.${ending}`, new Blob([text], { type: ending === "json" ? "application/json" : "text/xml" }));
  }

  async #saveModel() {
    try {
      this.#download("xml", await this.options.model(this.scene));
    } catch (error) {
      this.#say(/** @type {Error} */ (error).message, true);
    }
  }

  async #copyLink() {
    const link = this.options.address(writeScene(this.scene));
    await navigator.clipboard.writeText(link).then(() => this.#say("The link was copied."), () => this.#say(link));
  }

  /** Opens a scene as JSON, or that in a model of the benchmark. @param {File | undefined} file */
  async #open(file) {
    const { look, solids } = this.options.catalogue;
    try {
      const text = await file?.text() ?? "", scene = readScene(/^\s*</.test(text) ? readTexts(text).scene ?? "" : text, Object.keys(solids.robots));
      if (!look.arenas[scene.half_width ?? 1]) throw new Error(`This page has arenas with the half widths ${Object.keys(look.arenas).join(" and ")} only`);
      this.#change(scene);
    } catch (error) {
      this.#say(`${file?.name} cannot be opened. ${/** @type {Error} */ (error).message}`, true);
    }
    this.file.value = "";
  }
}

/** @type {Record<string, number>} the half size of a handle */
const SIZES = { robot: 0.2, block: 0.15, pebble: 0.05 };

/** The box of an object's handle. @param {string} name @param {any} object */
function boxOf(name, object) {
  if ("x_min" in object) return object;
  const size = SIZES[name.split(" ")[0]], { x, y } = object;
  return { x_min: x - size, y_min: y - size, x_max: x + size, y_max: y + size };
}
