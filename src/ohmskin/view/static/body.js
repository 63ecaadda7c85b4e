// A robot in space: its links, its skins coloured by what they feel, its contacts as arrows. Metres, z up.

import { number, paint } from "./colour.js";
import { doubtful, force, unsure } from "./contacts.js";
import { INK } from "./ink.js";
import { placed } from "./labels.js";
import * as THREE from "./vendor/three.js";

const SHORTEST = 500; // ms that a click presses
const CLICK = 5; // px that the pointer moves at most between down and up of a click
const FIXED = 0.06; // m, length of an arrow that tells no force
const PER_NEWTON = 0.02; // m
const [SHORT, LONGEST] = [0.03, 0.3]; // m, of such arrows
const SILENT = 0xffaca297; // the colour of what is not known, as a pixel
const RIM = 0x66717f;

THREE.ColorManagement.enabled = false; // colours are the page's, as they stand

const SHAPES = {
  box: (x, y, z) => new THREE.BoxGeometry(x, y, z),
  cylinder: (radius, length) => new THREE.CylinderGeometry(radius, radius, length, 48).rotateX(Math.PI / 2),
  capsule: (radius, length) => new THREE.CapsuleGeometry(radius, length, 12, 48).rotateX(Math.PI / 2),
  sphere: (radius) => new THREE.SphereGeometry(radius, 48, 32),
};

function posed(object, pose) {
  object.matrixAutoUpdate = false;
  object.matrix.set(...pose);
  return object;
}

/** Triangles between pixel centres, null off the skin; a closed band meets itself. Three of four corners will do. */
export function triangles(points, nx, ny, closed) {
  const found = [];
  for (let row = 0; row + 1 < ny; row++) {
    for (let column = 0; column + (closed ? 0 : 1) < nx; column++) {
      const next = (column + 1) % nx;
      const ring = [row * nx + column, row * nx + next, (row + 1) * nx + next, (row + 1) * nx + column];
      const there = ring.filter((place) => points[place]);
      if (there.length > 2) found.push(there.slice(0, 3));
      if (there.length > 3) found.push([there[0], there[2], there[3]]);
    }
  }
  return found;
}

/** Edges of one triangle only. */
function rim(faces) {
  const edges = new Map();
  for (const [a, b, c] of faces) {
    for (const [from, to] of [[a, b], [b, c], [c, a]]) {
      const key = `${Math.min(from, to)} ${Math.max(from, to)}`;
      edges.set(key, edges.has(key) ? null : [from, to]);
    }
  }
  return [...edges.values()].filter(Boolean).flat();
}

class Skin {
  constructor({ points, raster, domain }, number) {
    const faces = triangles(points, raster.nx, raster.ny, domain.kind === "band");
    const places = points.flatMap((point) => point ?? [0, 0, 0]);
    this.order = Uint32Array.from(points.keys());
    this.words = new Uint32Array(points.length);
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(places), 3));
    this.colour = new THREE.BufferAttribute(new Uint8Array(this.words.buffer), 4, true);
    shape.setAttribute("color", this.colour);
    shape.setIndex(faces.flat());
    shape.computeVertexNormals();
    const pulled = { polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -2 };
    const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, ...pulled });
    this.mesh = new THREE.Mesh(shape, material);
    this.mesh.userData.number = number;
    const line = new THREE.BufferGeometry();
    line.setAttribute("position", shape.getAttribute("position"));
    line.setIndex(rim(faces));
    this.mesh.add(new THREE.LineSegments(line, new THREE.LineBasicMaterial({ color: RIM })));
    const seen = points.filter(Boolean);
    this.middle = [0, 1, 2].map((axis) => seen.reduce((sum, point) => sum + point[axis], 0) / seen.length);
    this.radius = Math.max(...seen.map((point) => Math.hypot(...point.map((v, axis) => v - this.middle[axis]))));
  }

  show({ pixels, peak }, fresh, theme, limit, threshold) {
    const values = Float32Array.from(pixels, (code) => (code * peak) / 127);
    if (fresh) paint(values, this.order, this.words, theme, limit, threshold);
    else this.words.fill(SILENT);
    this.colour.needsUpdate = true;
  }
}

/** A ball, such as an electrode. */
class Ball extends THREE.Mesh {
  constructor() {
    super(new THREE.SphereGeometry(1, 24, 16), new THREE.MeshLambertMaterial());
  }
}

/** An arrow of length 1 along -z, with its tip at the origin. */
class Arrow extends THREE.Group {
  constructor() {
    super();
    this.material = new THREE.MeshLambertMaterial();
    this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.0035, 0.0035, 1, 16).rotateX(Math.PI / 2), this.material);
    this.head = new THREE.Mesh(new THREE.ConeGeometry(0.009, 0.022, 24).rotateX(-Math.PI / 2), this.material);
    this.head.position.z = 0.011;
    this.add(this.shaft, this.head);
  }

  /** From outside, along the normal, on to a point, so long (m). */
  point(at, normal, length, colour) {
    this.material.color.set(colour);
    this.shaft.scale.z = Math.max(0.001, length - 0.022);
    this.shaft.position.z = 0.022 + this.shaft.scale.z / 2;
    this.position.set(...at);
    this.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...normal));
  }
}

export class BodyView {
  /**
   * Draws on a canvas and writes into a box over it; open(name, mark) is called for the name of a patch and for the
   * text of its marks. With pick(at), a click on a skin calls it with the place in the link's frame, and presses
   * nothing.
   */
  constructor(canvas, box, robot, open, pick = null) {
    [this._canvas, this._box, this._open, this._pick] = [canvas, box, open, pick];
    this._renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this._renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.camera = new THREE.PerspectiveCamera(32, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this._scene = new THREE.Scene();
    const light = new THREE.DirectionalLight(0xffffff, 0.45 * Math.PI);
    light.position.set(0.3, 0.5, 1);
    this.camera.add(light); // what faces the reader has the very colour of the scale
    this._scene.add(this.camera, new THREE.AmbientLight(0xffffff, 0.62 * Math.PI));
    this.links = new Map();
    for (const [name, pose] of Object.entries(robot.links)) this.links.set(name, posed(new THREE.Group(), pose));
    this._scene.add(...this.links.values());
    for (const { link, pose, shape, size, colour } of robot.visuals) {
      const material = new THREE.MeshLambertMaterial({ color: new THREE.Color(...colour) });
      this.links.get(link).add(posed(new THREE.Mesh(SHAPES[shape](...size), material), pose));
    }
    this._scene.updateMatrixWorld(true);
    this.skins = [];
    this.arrows = [];
    this._balls = [];
    this._labels = [];
    this._aimed = null; // where the pointer went down, to pick
    this._fitted = -1; // with how many skins the camera was placed
    this._touch = null;
    this._patches = [];
    this._moved = false; // whether its reader has taken hold of the camera
    for (const [kind, act] of [["down", this._down], ["move", this._move], ["up", this._up], ["cancel", this._up]]) {
      canvas.addEventListener(`pointer${kind}`, act.bind(this)); // before the controls listen
    }
    this._controls = new THREE.OrbitControls(this.camera, canvas);
    this._controls.addEventListener("change", () => this._draw());
    new ResizeObserver(() => this._resize()).observe(canvas);
  }

  /** What is pressed, as the page's server reads it; null if nothing is. */
  get pressed() {
    if (this._touch?.until < performance.now()) this._touch = null;
    return this._touch && `${this._touch.number} ${this._touch.at.map((v) => v.toFixed(5)).join(" ")}`;
  }

  /** Where a point of a link's frame is on the page (px), and whether it is in front of the camera. */
  place(link, at) {
    const world = new THREE.Vector3(...at).applyMatrix4(this.links.get(link).matrixWorld);
    const { x, y, z } = world.clone().project(this.camera);
    const [w, h] = [this._canvas.clientWidth, this._canvas.clientHeight];
    return { x: ((x + 1) / 2) * w, y: ((1 - y) / 2) * h, shown: z < 1, world };
  }

  /** Links as the joints have put them by now. */
  pose(links) {
    for (const [name, pose] of Object.entries(links)) {
      const link = this.links.get(name);
      link?.matrix.set(...pose);
      link?.updateMatrixWorld(true);
    }
  }

  show(patches, known, stale, theme, limit, threshold) {
    this._labels = [];
    let [arrows, balls] = [0, 0];
    this._patches = patches;
    patches.forEach((patch, which) => {
      const link = this.links.get(patch.link);
      if (!link) return;
      if (patch.points) {
        this.skins[which]?.mesh.removeFromParent();
        this.skins[which] = new Skin(patch, which);
        link.add(this.skins[which].mesh);
        this._fit();
      }
      const [skin, fresh] = [this.skins[which], known && patch.age !== null && patch.age <= stale];
      skin?.show(patch, fresh, theme, limit, threshold);
      const silent = patch.age === null ? "no data yet" : known ? `silent for ${number(patch.age, 1)} s` : "unknown";
      const at = skin?.middle ?? [0, 0, 0];
      this._labels.push({ link: patch.link, at, up: skin?.radius ?? 0, name: patch.name, text: fresh ? "" : silent });
      for (const contact of fresh ? patch.contacts : []) {
        const arrow = (this.arrows[arrows++] ??= new Arrow());
        link.add(arrow);
        this._contact(patch, contact, arrow, theme);
      }
      for (const { at, normal, text, radius } of patch.marks ?? []) {
        const ball = (this._balls[balls++] ??= new Ball());
        ball.material.color.set(INK[theme].press);
        ball.scale.setScalar(radius);
        ball.position.set(...at);
        link.add(ball);
        const out = at.map((v, axis) => v + 3 * radius * normal[axis]);
        this._labels.push({ link: patch.link, at: out, up: 0, text, normal, of: patch.name, mark: text });
      }
    });
    for (const ball of this._balls.slice(balls)) ball.removeFromParent();
    for (const arrow of this.arrows.slice(arrows)) arrow.removeFromParent();
    this._draw();
  }

  _contact(patch, contact, arrow, theme) {
    const { id, in: at, normal, force: newtons, self_touch: own } = contact;
    const told = force(contact);
    const length = told ? Math.min(LONGEST, Math.max(SHORT, PER_NEWTON * Math.abs(newtons))) : FIXED;
    const { other, doubt, felt, quiet } = INK[theme];
    arrow.point(at, normal, length, own ? other : doubtful(contact) ? doubt : told ? felt : quiet);
    const size = told ? `${told} N` : patch.newtons ? "force not known yet" : "uncalibrated";
    const text = [`#${id}`, size, unsure(contact), own && "self-touch"].filter(Boolean).join(" · ");
    const tail = at.map((v, axis) => v + (length + 0.01) * normal[axis]);
    this._labels.push({ link: patch.link, at: tail, up: 0, text, normal, of: patch.name, foot: at });
  }

  _draw() {
    if (this._fitted < 0) return;
    this._renderer.render(this._scene, this.camera);
    const high = this._canvas.clientHeight / (2 * Math.tan((this.camera.fov * Math.PI) / 360));
    const seen = this._labels.map((label) => {
      const found = this.place(label.link, label.at);
      const beside = (0.8 * label.up * high) / found.world.distanceTo(this.camera.position);
      const text = label.name ? `${label.name}${label.text ? `\n${label.text}` : ""}` : label.text;
      return { ...found, x: found.x + beside, text, begins: Boolean(label.name), moves: found.shown && !label.mark };
    });
    const { clientWidth, clientHeight } = this._canvas;
    const contacts = this._labels.filter(({ foot }) => foot).map(({ link, foot }) => this.place(link, foot));
    const free = placed(seen.filter(({ moves }) => moves), [clientWidth, clientHeight], contacts).values();
    this._labels.forEach((label, which) => {
      const { shown, world, text, moves } = seen[which];
      const [x, y] = moves ? free.next().value : [seen[which].x, seen[which].y];
      const line = this._line(which);
      line.hidden = !shown;
      const behind = label.normal && this._behind(label, world);
      line.dataset.kind = label.name ? "patch" : behind ? "behind" : "contact";
      if (line.textContent !== text) line.textContent = text;
      line.dataset.silent = Boolean(label.name && label.text);
      line.dataset.patch = label.name ?? label.of;
      line.dataset.mark = label.mark ?? "";
      const moved = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      line.style.transform = `${label.name ? "translate(0, -50%)" : "translate(-50%, -50%)"} ${moved}`;
    });
    for (let which = this._labels.length; which < this._box.children.length; which++) this._line(which).hidden = true;
  }

  /** Whether the skin under a label faces away. */
  _behind({ link, normal }, world) {
    const out = new THREE.Vector3(...normal).transformDirection(this.links.get(link).matrixWorld);
    return out.dot(this.camera.position.clone().sub(world)) < 0;
  }

  _line(which) {
    if (this._box.children[which]) return this._box.children[which];
    const line = document.createElement("button");
    line.onclick = () => this._open(line.dataset.patch, line.dataset.mark);
    this._box.append(line);
    return line;
  }

  /** The whole robot, from the front, its left and above; again when another patch comes. */
  _fit() {
    const bounds = new THREE.Box3().setFromObject(this._scene).getBoundingSphere(new THREE.Sphere());
    const count = this.skins.filter(Boolean).length;
    if (this._moved || count <= this._fitted || !(bounds.radius > 0)) return;
    this._fitted = count;
    const wide = Math.min(1, this.camera.aspect);
    const far = (0.88 * bounds.radius) / Math.sin((this.camera.fov * Math.PI) / 360) / wide;
    this._controls.target.copy(bounds.center);
    this.camera.position.set(0.8, 0.5, 0.4).normalize().multiplyScalar(far).add(bounds.center);
    this._controls.update();
  }

  _resize() {
    const { clientWidth: w, clientHeight: h } = this._canvas;
    if (!w || !h) return;
    this._renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this._renderer.setSize(w, h, false);
    this.camera.aspect = w / h;
    this.camera.updateProjectionMatrix();
    if (!this._moved) this._fitted = -1;
    this._fit();
    this._draw();
  }

  /** The patch under the pointer, and where in its link's frame. */
  _under(event, only = null) {
    const box = this._canvas.getBoundingClientRect();
    const at = new THREE.Vector2(
      ((event.clientX - box.left) / box.width) * 2 - 1,
      1 - ((event.clientY - box.top) / box.height) * 2,
    );
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, this.camera);
    const solid = [...this.links.values()].flatMap((link) =>
      link.children.filter((child) => child.isMesh && !(child instanceof Ball)),
    );
    const hit = ray.intersectObjects(only ? [only] : solid, false)[0]; // arrows are groups
    const number = hit?.object.userData.number;
    if (number === undefined) return null;
    return { number, mesh: hit.object, at: hit.object.worldToLocal(hit.point.clone()).toArray() };
  }

  _down(event) {
    const found = event.button === 0 ? this._under(event) : null;
    this._moved = true;
    this._aimed = found && this._pick ? { ...found, x: event.clientX, y: event.clientY } : null;
    if (!found || this._pick || !this._patches[found.number].virtual) return;
    this._controls.enabled = false; // this finger presses and does not turn
    this._canvas.setPointerCapture(event.pointerId);
    this._touch = { ...found, pointer: event.pointerId, since: performance.now(), until: Infinity };
  }

  _move(event) {
    if (this._touch?.pointer !== event.pointerId || this._touch.until < Infinity) return;
    this._touch.at = this._under(event, this._touch.mesh)?.at ?? this._touch.at;
  }

  _up(event) {
    if (this._aimed && event.type === "pointerup") {
      const { at, x, y } = this._aimed;
      if (Math.hypot(event.clientX - x, event.clientY - y) < CLICK) this._pick(at); // a drag turns
    }
    this._aimed = null;
    if (this._touch?.pointer !== event.pointerId) return;
    this._controls.enabled = true;
    this._touch.until = Math.max(performance.now(), this._touch.since + SHORTEST);
  }
}
