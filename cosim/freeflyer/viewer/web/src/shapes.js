// Geometry of the robot, frames, arrows and labels.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  CapsuleGeometry,
  Color,
  ConeGeometry,
  CylinderGeometry,
  EdgesGeometry,
  Group,
  LineBasicMaterial,
  LinearFilter,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  SphereGeometry,
  Sprite,
  SpriteMaterial,
  SRGBColorSpace,
  Vector3,
} from "three";
import { MEANING } from "./colors.js";
import { poseMatrix } from "./kinematics.js";
import { bytesOf } from "./series.js";

const GAP = 12; // between a point and its label [px]
const point = new Vector3();

const alongZ = (geometry) => geometry.rotateX(Math.PI / 2);

/** @param {any} visual of scene.json */
function geometryOf(visual) {
  const { shape, radius, length } = visual;
  if (shape === "box") return new BoxGeometry(...visual.size);
  if (shape === "sphere") return new SphereGeometry(radius, 32, 20);
  if (shape === "cylinder") return alongZ(new CylinderGeometry(radius, radius, length, 36));
  if (shape === "capsule") return alongZ(new CapsuleGeometry(radius, length, 8, 28));
  if (shape === "mesh") {
    const vertices = new Float32Array(bytesOf(visual.vertices));
    const triangles = new Uint32Array(bytesOf(visual.triangles));
    if (!vertices.every(Number.isFinite) || !triangles.every((k) => 3 * k < vertices.length)) return null;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(vertices, 3));
    geometry.setIndex(new BufferAttribute(triangles, 1));
    return geometry;
  }
  return null;
}

/** A visual as a group at its pose, or null if it cannot be drawn. @param {any} visual of scene.json */
export function drawVisual(visual) {
  const sizes = [visual.radius, visual.length, ...(visual.size ?? []), ...visual.position, ...visual.orientation];
  const geometry = sizes.every((value) => value === undefined || Number.isFinite(value)) ? geometryOf(visual) : null;
  if (!geometry) return null;
  geometry.computeBoundingSphere();
  if (!(geometry.boundingSphere.radius > 0)) return null;
  const mesh = visual.shape === "mesh";
  const [r, g, b, a] = visual.color ?? [0.8, 0.8, 0.8, 1];
  const material = new MeshStandardMaterial({
    color: new Color().setRGB(r, g, b, SRGBColorSpace),
    roughness: 0.55,
    metalness: 0.15,
    flatShading: mesh,
    transparent: a < 1,
    opacity: a,
    depthWrite: a >= 1,
  });
  const group = new Group();
  group.matrixAutoUpdate = false;
  group.matrix.fromArray(poseMatrix(visual));
  group.add(new Mesh(geometry, material));
  if (visual.shape === "box" || visual.shape === "cylinder") {
    const edges = new LineBasicMaterial({ color: 0x101820, transparent: true, opacity: 0.35 });
    group.add(new LineSegments(new EdgesGeometry(geometry, 40), edges));
  }
  return group;
}

const SHAFT = new CylinderGeometry(1, 1, 1, 14).translate(0, 0.5, 0);
const HEAD = new ConeGeometry(1, 1, 20).translate(0, 0.5, 0);

/** An arrow along its y axis; the length is set by setLength. With two heads it is a torque. */
export class Arrow extends Group {
  constructor(color, radius, heads = 1, opacity = 1) {
    super();
    const material = new MeshBasicMaterial({ color, depthTest: false, transparent: true, opacity });
    this.shaft = new Mesh(SHAFT, material);
    this.heads = Array.from({ length: heads }, () => new Mesh(HEAD, material));
    this.radius = radius;
    this.add(this.shaft, ...this.heads);
    this.traverse((object) => (object.renderOrder = 10));
  }

  setLength(length) {
    const head = Math.min(7 * this.radius, 0.6 * length);
    this.shaft.scale.set(this.radius, Math.max(1e-9, length - head * this.heads.length * 0.8), this.radius);
    this.heads.forEach((mesh, k) => {
      mesh.scale.set(0.4 * head, head, 0.4 * head);
      mesh.position.y = length - head * (1 + 0.8 * k);
    });
  }
}

/** Three axes of a frame: x, y, z in vermillion, green, blue. */
export function triad(length, radius, opacity = 1) {
  const group = new Group();
  MEANING.axes.forEach((color, axis) => {
    const arrow = new Arrow(color, radius, 1, opacity);
    arrow.setLength(length);
    if (axis === 0) arrow.rotation.z = -Math.PI / 2;
    if (axis === 2) arrow.rotation.x = Math.PI / 2;
    group.add(arrow);
  });
  group.matrixAutoUpdate = false;
  return group;
}

/** A text beside a point, of constant size on the screen. */
export class Label extends Sprite {
  /** @param {number} x @param {number} y side of the point: -1 left or below, 0 centred, 1 right or above */
  constructor(x, y) {
    super(new SpriteMaterial({ depthTest: false, transparent: true, sizeAttenuation: false, toneMapped: false }));
    this.side = [x, y];
    this.renderOrder = 20;
    this.text = "";
  }

  /** @param {string} text @param {string} color of the mark @param {{background: string, text: string}} theme */
  write(text, color, theme) {
    const key = [text, color, theme.background].join("\n");
    if (key === this.text) return;
    this.text = key;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const canvas = document.createElement("canvas");
    const context = canvas.getContext("2d");
    const font = "600 12px system-ui, sans-serif";
    context.font = font;
    const width = Math.min(360, Math.ceil(context.measureText(text).width) + 24);
    const height = 20;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    context.scale(ratio, ratio);
    context.globalAlpha = 0.88;
    context.fillStyle = theme.background;
    context.beginPath();
    context.roundRect(0, 0, width, height, 5);
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = color;
    context.beginPath();
    context.roundRect(4, 5, 10, 10, 3);
    context.fill();
    context.font = font;
    context.textBaseline = "middle";
    context.fillStyle = theme.text;
    context.fillText(text, 18, height / 2 + 1, width - 22);
    this.material.map?.dispose();
    this.material.map = new CanvasTexture(canvas);
    this.material.map.generateMipmaps = false;
    this.material.map.minFilter = LinearFilter;
    this.material.map.colorSpace = SRGBColorSpace;
    this.material.needsUpdate = true;
    this.pixels = [width, height];
  }

  /** Scale for a view of `width` and `height` pixels, and keep the text inside. @param {number} tangent of half of the field of view */
  fit(camera, width, height, tangent) {
    if (!this.pixels) return;
    this.scale.set((this.pixels[0] * 2 * tangent) / height, (this.pixels[1] * 2 * tangent) / height, 1);
    const x = ((this.getWorldPosition(point).project(camera).x + 1) / 2) * width;
    const [wide, high] = this.pixels;
    const right = x + GAP;
    const left = x - GAP - wide;
    const wanted = (this.side[0] > 0 ? right + wide <= width || left < 0 : left < 0 && right + wide <= width) ? right : left;
    const shown = x >= 0 && x <= width; // a label of a point outside stays outside
    const from = shown ? Math.min(Math.max(wanted, 4), Math.max(4, width - wide - 4)) : right;
    this.center.set(shown || x === x ? (x - from) / wide : 0, 0.5 - this.side[1] * (0.5 + GAP / high));
  }
}

/** Outline of a box with faint faces. */
export function ghostOfBox(box, color) {
  const size = box.max.clone().sub(box.min);
  const center = box.min.clone().add(box.max).multiplyScalar(0.5);
  const solid = new BoxGeometry(size.x, size.y, size.z).translate(center.x, center.y, center.z);
  const faces = new MeshBasicMaterial({ color, transparent: true, opacity: 0.1, depthWrite: false });
  return new Group().add(new LineSegments(new EdgesGeometry(solid), new LineBasicMaterial({ color })), new Mesh(solid, faces));
}
