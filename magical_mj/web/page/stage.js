// @ts-check
/** Renders a model in 3-D with soft light, by three.js. MuJoCo computes its helper geoms (contacts, joints, ...). */
import * as THREE from "./three/three.module.js";
import { Insets } from "./insets.js";
import { OrbitControls } from "./three/OrbitControls.js";

/** The flags of mjvOption for helper geoms, by the names of the page's switches. */
const HELPERS = { joints: ["JOINT"], contacts: ["CONTACTPOINT", "CONTACTFORCE"], inertia: ["INERTIA"], tendons: ["TENDON"] };
/** Groups of geoms, by the names of the page's switches. Other groups are always shown. */
const GROUPS = { flat: [2], collision: [3] };
const FLAT = 10;  // the layer of geoms in pictures of the task's own cameras
const DRAWN = [2, 4];  // the groups in these pictures
const [PLANE, FIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH] = [0, 1, 2, 3, 4, 5, 6, 7];
const [ARROW, ARROW1, ARROW2, LINE, LINEBOX] = [100, 101, 102, 103, 104];
const ROUGH = 0.6;  // rendered pixels per screen pixel, for movement on a slow machine
const INERTIA = 0.25;  // the opacity of its boxes

export class Stage {
  /** @param {HTMLCanvasElement} canvas @param {() => void} changed  called when a new picture is needed */
  constructor(canvas, changed) {
    this.canvas = canvas;
    const isSoftware = drawsBySoftware();
    /** Whether this machine is too slow for shadows and fine pixels while something moves. */
    this.slow = isSoftware;
    /** Rendered pixels per screen pixel of a still picture. More without anti-aliasing, which is slow in software. */
    this.fineness = isSoftware ? 1.5 : Math.min(devicePixelRatio, 2);
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !isSoftware });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.shadowMap.autoUpdate = false;  // insets have no shadows
    this.renderer.autoClear = false;
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.insets = true;
    this.places = new Insets(canvas, () => this.insets ? this.#insetCount : 0, changed);  // before the controls, which it keeps from turning the view
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener("change", changed);
    this.scene = new THREE.Scene();
    this.shown = { joints: false, contacts: false, inertia: false, tendons: true, flat: true, collision: false, solid: true };
    /** @type {any[]} a mesh for each geom, or null */
    this.meshes = [];
    /** @type {any} */
    this.inspected = null;
    /** @type {any} */
    this.lamp = null;
  }

  /** Only the model's first two cameras have pictures. */
  get #insetCount() {
    return Math.min(2, this.inspected?.model.ncam ?? 0);
  }

  /** Shows another model, with the initial camera of its file. @param {import("./inspected.js").InspectedModel} inspected */
  open(inspected) {
    this.close();
    this.inspected = inspected;
    const { mujoco, model } = inspected, { stat, vis } = model;
    this.option = new mujoco.MjvOption();
    this.option.geomgroup.fill(0);  // geoms have meshes of their own
    this.perturbation = new mujoco.MjvPerturb();
    this.eye = new mujoco.MjvCamera();
    this.helpers = new mujoco.MjvScene(model, 4000);
    this.root = new THREE.Group();
    this.scene.add(this.root);
    this.decoration = new THREE.Group();
    this.scene.add(this.decoration);
    /** @type {Map<string, any>} */
    this.geometries = new Map();
    this.meshes = Array.from({ length: model.ngeom }, (_, geom) => this.#mesh(geom));
    const extent = stat.extent || 1, [x, y, z] = stat.center;
    const azimuth = vis.global.azimuth * Math.PI / 180, elevation = vis.global.elevation * Math.PI / 180;
    const away = 1.5 * extent * Math.max(1, 1.15 * this.canvas.clientHeight / this.canvas.clientWidth);
    this.orbit.target.set(x, y, z);
    this.camera.position.set(
      x - away * Math.cos(azimuth) * Math.cos(elevation), y - away * Math.sin(azimuth) * Math.cos(elevation), z - away * Math.sin(elevation));
    this.camera.fov = 30;
    this.camera.near = extent / 100;
    this.camera.far = 50 * extent;
    this.camera.updateProjectionMatrix();
    this.orbit.maxDistance = 10 * extent;
    this.orbit.update();
    this.#light(extent, new THREE.Vector3(x, y, z));
    this.select(-1);
  }

  close() {
    if (!this.inspected) return;
    for (const helper of [this.option, this.perturbation, this.eye, this.helpers]) helper.delete();
    this.lamp?.dispose();  // with its shadows
    this.scene.traverse((/** @type {any} */ { material }) => {
      material?.map?.dispose();
      material?.dispose();
    });
    this.scene.clear();
    for (const geometry of this.geometries?.values() ?? []) geometry.dispose();
    this.inspected = null;
  }

  /** Ambient light, and a lamp with soft shadows. @param {number} extent @param {any} centre */
  #light(extent, centre) {
    this.scene.background = new THREE.Color(isDark() ? 0x23252b : 0xe7e7ea);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xdddde4, 2.1));
    const lamp = new THREE.DirectionalLight(0xffffff, 1.25);
    lamp.position.copy(centre).add(new THREE.Vector3(-0.36, -0.24, 1).multiplyScalar(2 * extent));
    lamp.target.position.copy(centre);
    lamp.castShadow = true;
    lamp.shadow.mapSize.set(2048, 2048);
    lamp.shadow.radius = 6;
    lamp.shadow.normalBias = extent / 800;
    const { camera } = lamp.shadow, reach = 0.75 * extent;
    Object.assign(camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: extent / 10, far: 4 * extent });
    camera.updateProjectionMatrix();
    this.scene.add(lamp, lamp.target);
    this.lamp = lamp;
  }

  /** @param {number} geom */
  #mesh(geom) {
    const { model } = this.inspected, type = model.geom_type[geom], group = model.geom_group[geom];
    const size = [...model.geom_size.subarray(3 * geom, 3 * geom + 3)];
    const geometry = this.#geometry(type, size, model.geom_dataid[geom]);
    if (!geometry) return null;
    const material = model.geom_matid[geom];
    const rgba = material < 0 ? model.geom_rgba.subarray(4 * geom, 4 * geom + 4) : model.mat_rgba.subarray(4 * material, 4 * material + 4);
    const colour = new THREE.Color().setRGB(rgba[0], rgba[1], rgba[2], THREE.SRGBColorSpace);
    const side = type === PLANE ? THREE.FrontSide : THREE.DoubleSide;
    const isCollision = GROUPS.collision.includes(group);
    const look = { color: colour, side, transparent: rgba[3] < 1 || isCollision, opacity: rgba[3] };
    const map = type === PLANE ? this.#texture(material, size) : null;
    const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ ...look, map }));
    if (isCollision) {
      mesh.material.color.set(0xd0503c);
      Object.assign(mesh.material, { opacity: 0, depthWrite: false });
      mesh.add(new THREE.LineSegments(this.#edges(type, size, geometry), OUTLINE));
    }
    if (isDark() && SURROUND.includes(this.inspected.name("geom", geom))) mesh.material.color.multiplyScalar(0.04);  // not in the observations of policies
    mesh.castShadow = type !== PLANE && !isCollision && !GROUPS.flat.includes(group) && rgba[3] > 0;
    mesh.receiveShadow = !isCollision;
    mesh.userData = { geom, group };
    mesh.matrixAutoUpdate = false;
    if (DRAWN.includes(group)) {
      const flat = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(look));
      flat.layers.set(FLAT);
      flat.raycast = () => {};
      mesh.add(flat);
    }
    this.root.add(mesh);
    return mesh;
  }

  /** The texture of a plane, repeated according to the material. @param {number} material @param {number[]} size */
  #texture(material, size) {
    const { model } = this.inspected, roles = material < 0 ? [] : [...model.mat_texid.subarray(10 * material, 10 * material + 10)];
    const texture = roles.find((id) => id >= 0);
    if (texture === undefined || model.tex_type[texture] !== 0) return null;
    const width = model.tex_width[texture], height = model.tex_height[texture], channels = model.tex_nchannel[texture], first = model.tex_adr[texture];
    const pixels = new Uint8Array(4 * width * height).fill(255);
    for (let i = 0; i < width * height; i++) for (let c = 0; c < Math.min(3, channels); c++) pixels[4 * i + c] = model.tex_data[first + channels * i + c];
    const map = new THREE.DataTexture(pixels, width, height);
    map.colorSpace = THREE.SRGBColorSpace;
    map.wrapS = map.wrapT = THREE.RepeatWrapping;
    map.magFilter = map.minFilter = THREE.LinearFilter;
    const [x, y] = model.mat_texrepeat.subarray(2 * material, 2 * material + 2);
    const isUniform = x < 10;  // MuJoCo's build does not expose this flag. Fewer repetitions would not be a pattern
    map.repeat.set(isUniform ? x * (size[0] || 50) : x, isUniform ? y * (size[1] || 50) : y);
    map.needsUpdate = true;
    return map;
  }

  /** The edges of a geometry. Round ones have those of a coarser shape. @param {number} type @param {number[]} size @param {any} geometry */
  #edges(type, [a, b], geometry) {
    const { geometries } = this, key = geometry.uuid;
    if (!geometries.has(key)) {
      const coarse = type === SPHERE ? new THREE.SphereGeometry(a, 12, 6).rotateX(Math.PI / 2)
        : type === CAPSULE ? new THREE.CapsuleGeometry(a, 2 * b, 2, 8).rotateX(Math.PI / 2) : null;
      geometries.set(key, new THREE.EdgesGeometry(coarse ?? geometry, coarse ? 1 : 20));
      coarse?.dispose();
    }
    return geometries.get(key);
  }

  /** The geometry of a geom. Geoms of the same size share it. @param {number} type @param {number[]} size @param {number} dataid */
  #geometry(type, size, dataid) {
    const key = `${type} ${type === MESH ? dataid : size}`, { geometries } = this;
    if (!geometries.has(key)) geometries.set(key, this.#made(type, size, dataid));
    return geometries.get(key);
  }

  /** @param {number} type @param {number[]} size @param {number} dataid */
  #made(type, [a, b, c], dataid) {
    const { model } = this.inspected;
    const far = 20 * (model.stat.extent || 1);
    if (type === PLANE) return new THREE.PlaneGeometry(2 * (a || far), 2 * (b || far));
    if (type === SPHERE) return new THREE.SphereGeometry(a, 24, 16);
    if (type === CAPSULE) return new THREE.CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
    if (type === ELLIPSOID) return new THREE.SphereGeometry(1, 24, 16).scale(a, b, c);
    if (type === CYLINDER) return new THREE.CylinderGeometry(a, a, 2 * b, 48).rotateX(Math.PI / 2);
    if (type === BOX) return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    if (type === FIELD) return heightField(model, dataid);
    return type === MESH && dataid >= 0 ? polyhedron(model, dataid) : null;
  }

  /** Highlights a body; -1: none. @param {number} body */
  select(body) {
    const { model } = this.inspected;
    for (const mesh of this.meshes) {
      const isChosen = mesh && body > 0 && within(model, model.geom_bodyid[mesh.userData.geom], body);
      mesh?.material.emissive.set(isChosen ? 0x5a3c00 : 0);
    }
  }

  /** The body at a position on the canvas, or -1. @param {number} x  pixels from the left @param {number} y */
  bodyAt(x, y) {
    const ray = new THREE.Raycaster(), { clientWidth: width, clientHeight: height } = this.canvas;
    ray.setFromCamera(new THREE.Vector2(2 * x / width - 1, 1 - 2 * y / height), this.camera);
    const [hit] = ray.intersectObjects(this.meshes.filter((mesh) => mesh?.visible), false);
    return hit ? this.inspected.model.geom_bodyid[hit.object.userData.geom] : -1;
  }

  /** Renders the current state. @param {boolean} isMoving  whether the next picture follows immediately */
  draw(isMoving = false) {
    const { inspected, renderer, canvas } = this, isRough = isMoving && this.slow;
    if (!inspected) return;
    this.lamp.castShadow = renderer.shadowMap.needsUpdate = !isRough;
    const ratio = isRough ? ROUGH : this.fineness, { clientWidth: width, clientHeight: height } = canvas;
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.#updatePoses();
    this.#decorate();
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, width, height);
    renderer.clear();
    renderer.render(this.scene, this.camera);
    if (this.insets) this.#drawInsets(height);
  }

  #updatePoses() {
    const { data } = this.inspected, positions = data.geom_xpos, turns = data.geom_xmat;
    for (const mesh of this.meshes) {
      if (!mesh) continue;
      const { geom, group } = mesh.userData, p = 3 * geom, t = 9 * geom;
      mesh.visible = GROUPS.flat.includes(group) ? this.shown.flat : GROUPS.collision.includes(group) ? this.shown.collision
        : group < 2 ? this.shown.solid : group !== 4;
      mesh.matrix.set(turns[t], turns[t + 1], turns[t + 2], positions[p], turns[t + 3], turns[t + 4], turns[t + 5], positions[p + 1],
        turns[t + 6], turns[t + 7], turns[t + 8], positions[p + 2], 0, 0, 0, 1);
      mesh.matrixWorldNeedsUpdate = true;
    }
  }

  /** Places helper geoms such as joints and contacts, like MuJoCo's own viewer. */
  #decorate() {
    const { mujoco, model, data } = this.inspected, { flags } = this.option;
    for (const [name, kinds] of Object.entries(HELPERS)) {
      for (const kind of kinds) flags[mujoco.mjtVisFlag[`mjVIS_${kind}`].value] = Number(this.shown[/** @type {keyof typeof HELPERS} */ (name)]);
    }
    mujoco.mjv_updateScene(model, data, this.option, this.perturbation, this.eye, mujoco.mjtCatBit.mjCAT_ALL.value, this.helpers);
    const all = this.helpers.geoms, count = this.helpers.ngeom, { children } = this.decoration, boxes = new Set();
    for (let i = 0; i < count; i++) {
      const geom = all.get(i);
      const child = children[i] ?? this.#helper();
      shape(child, geom.type, this.#limited(geom.type, geom.size));
      const [x, y, z] = geom.pos, [a, b, c, d, e, f, g, h, k] = geom.mat;
      child.userData.base.set(a, b, c, x, d, e, f, y, g, h, k, z, 0, 0, 0, 1);
      child.matrix.multiplyMatrices(child.userData.base, child.userData.stretch);
      child.matrixWorldNeedsUpdate = true;
      const [red, green, blue, opacity] = geom.rgba;
      child.material.color.setRGB(red, green, blue, THREE.SRGBColorSpace);
      const isInertia = geom.type === BOX, place = isInertia ? [...geom.pos, ...geom.size].map((value) => value.toFixed(3)).join() : "";
      child.material.opacity = isInertia ? INERTIA : opacity;
      child.material.depthWrite = !isInertia;
      child.visible = !isInertia || !boxes.has(place);  // wheels and rotors have equal boxes in one place
      boxes.add(place);
      geom.delete();
    }
    all.delete();
    for (const child of children.slice(count)) child.visible = false;
  }

  /** Limits sizes to the scale of the model, since forces range over many powers of ten. @param {number} type @param {Float32Array} size */
  #limited(type, [a, b, c]) {
    const extent = this.inspected.model.stat.extent || 1, most = (/** @type {number} */ value, /** @type {number} */ limit) => limit * (1 - Math.exp(-value / limit));
    if (type === CYLINDER) return [Math.min(a, 0.012 * extent), Math.min(b, 0.012 * extent), Math.min(c || b, 0.002 * extent)];
    return type === ARROW || type === ARROW1 || type === ARROW2 ? [Math.min(a, 0.006 * extent), Math.min(b, 0.006 * extent), most(c, 0.1 * extent)] : [a, b, c];
  }

  #helper() {
    const mesh = new THREE.Mesh(UNIT.box, new THREE.MeshLambertMaterial({ transparent: true, depthTest: true }));
    mesh.matrixAutoUpdate = false;
    mesh.userData = { base: new THREE.Matrix4(), stretch: new THREE.Matrix4() };
    this.decoration.add(mesh);
    return mesh;
  }

  /** The pictures of the model's own first two cameras. @param {number} height  of the canvas */
  #drawInsets(height) {
    const { model, data } = this.inspected;
    this.places.places(this.#insetCount).forEach(({ left, top, side }, id) => {
      const fovy = model.cam_fovy[id], far = 50 * (model.stat.extent || 1), isFlat = this.inspected.controls !== null;
      const camera = model.cam_projection[id]
        ? new THREE.OrthographicCamera(-fovy / 2, fovy / 2, fovy / 2, -fovy / 2, -far, far) : new THREE.PerspectiveCamera(fovy, 1, far / 5000, far);
      const [x, y, z] = data.cam_xpos.subarray(3 * id, 3 * id + 3), turn = data.cam_xmat.subarray(9 * id, 9 * id + 9);
      camera.matrixAutoUpdate = false;
      camera.matrix.set(turn[0], turn[1], turn[2], x, turn[3], turn[4], turn[5], y, turn[6], turn[7], turn[8], z, 0, 0, 0, 1);
      camera.matrixWorldNeedsUpdate = true;
      if (isFlat) camera.layers.set(FLAT);
      this.renderer.setScissorTest(true);
      this.renderer.setScissor(left - 1, height - top - side - 1, side + 2, side + 2);
      this.renderer.setClearColor(0x8d909b);
      this.renderer.clear();
      this.renderer.setViewport(left, height - top - side, side, side);
      this.renderer.setScissor(left, height - top - side, side, side);
      const { background } = this.scene, hidden = this.meshes.filter((mesh) => mesh && isFlat && !mesh.visible && DRAWN.includes(mesh.userData.group));
      if (isFlat) this.scene.background = WHITE;
      for (const mesh of hidden) mesh.visible = true;
      this.renderer.render(this.scene, camera);
      for (const mesh of hidden) mesh.visible = false;
      this.scene.background = background;
    });
  }

  /** The picture as a PNG. @returns {Promise<Blob>} */
  picture() {
    this.draw();
    return new Promise((resolve, reject) => this.canvas.toBlob((blob) => blob ? resolve(blob) : reject(new Error("this browser cannot save the picture"))));
  }
}

const SURROUND = ["floor", "surround"];
const isDark = () => document.documentElement.dataset.theme === "dark";
const WHITE = new THREE.Color(0xffffff);
const OUTLINE = new THREE.LineBasicMaterial({ color: 0xd0503c });
const UNIT = {
  box: new THREE.BoxGeometry(2, 2, 2), sphere: new THREE.SphereGeometry(1, 16, 12),
  cylinder: new THREE.CylinderGeometry(1, 1, 2, 20).rotateX(Math.PI / 2), rod: new THREE.CylinderGeometry(1, 1, 1, 8).rotateX(Math.PI / 2).translate(0, 0, 0.5),
  arrow: arrow(),
};

/** An arrow of length and width 1 along z. */
function arrow() {
  const profile = [[0, 0], [0.45, 0], [0.45, 0.8], [1, 0.8], [0, 1]].map(([x, y]) => new THREE.Vector2(x, y));
  return new THREE.LatheGeometry(profile, 16).rotateX(Math.PI / 2);
}

/** Whether WebGL runs in software. */
function drawsBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), about = gl?.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(about ? gl?.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
}

/** Shapes a mesh like one of MuJoCo's helper geoms. @param {any} mesh @param {number} type @param {number[]} size */
function shape(mesh, type, [a, b, c]) {
  const { stretch } = mesh.userData;
  if (type === ARROW || type === ARROW1 || type === ARROW2) {
    mesh.geometry = UNIT.arrow;
    stretch.makeScale(a, b, c);
  } else if (type === LINE) {
    mesh.geometry = UNIT.rod;
    stretch.makeScale(0.002, 0.002, c);
  } else {
    mesh.geometry = type === SPHERE || type === ELLIPSOID ? UNIT.sphere : type === CYLINDER || type === CAPSULE ? UNIT.cylinder : UNIT.box;
    if (type === SPHERE) stretch.makeScale(a, a, a);
    else if (type === LINEBOX || type === BOX || type === ELLIPSOID) stretch.makeScale(a, b, c);
    else stretch.makeScale(a, b, c || b);
  }
}

/** A mesh of the model, with flat faces. @param {any} model @param {number} id */
function polyhedron(model, id) {
  const vertex = 3 * model.mesh_vertadr[id], face = 3 * model.mesh_faceadr[id];
  const vertices = model.mesh_vert.subarray(vertex, vertex + 3 * model.mesh_vertnum[id]);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(vertices), 3));
  geometry.setIndex([...model.mesh_face.subarray(face, face + 3 * model.mesh_facenum[id])]);
  const flat = geometry.toNonIndexed();
  flat.computeVertexNormals();
  return flat;
}

/** @param {any} model @param {number} id */
function heightField(model, id) {
  const rows = model.hfield_nrow[id], columns = model.hfield_ncol[id], first = model.hfield_adr[id];
  const [x, y, top] = model.hfield_size.subarray(4 * id, 4 * id + 4);
  const geometry = new THREE.PlaneGeometry(2 * x, 2 * y, columns - 1, rows - 1), position = geometry.attributes.position;
  for (let row = 0; row < rows; row++) for (let column = 0; column < columns; column++) {
    position.setZ((rows - 1 - row) * columns + column, top * model.hfield_data[first + row * columns + column]);
  }
  geometry.computeVertexNormals();
  return geometry;
}

/** Whether a body equals another one, or is its descendant. @param {any} model @param {number} body @param {number} whole */
function within(model, body, whole) {
  for (let one = body; one > 0; one = model.body_parentid[one]) if (one === whole) return true;
  return false;
}
