/** One picture of one model: what is drawn, from where, and what lies under the pointer. */

import {
  AmbientLight,
  Box3,
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  type ColorRepresentation,
  DirectionalLight,
  DoubleSide,
  GreaterDepth,
  Group,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  OrthographicCamera,
  Plane,
  Points,
  PointsMaterial,
  Raycaster,
  Scene,
  SRGBColorSpace,
  TextureLoader,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Line2 } from "three/addons/lines/Line2.js";
import { LineGeometry } from "three/addons/lines/LineGeometry.js";
import { LineMaterial, type LineMaterialParameters } from "three/addons/lines/LineMaterial.js";

import { layerColours } from "./colours";
import type { Layer, Model, Surface, Vector } from "./format";
import { type Place, Skin, type Way } from "./geodesic";
import { Lengths } from "./lengths";

export const DIRECTIONS: Record<string, { title: string; from: Vector; up: Vector }> = {
  front: { title: "Front", from: [0, 0, 1], up: [0, 1, 0] },
  left: { title: "Left", from: [1, 0, 0.0001], up: [0, 1, 0] },
  right: { title: "Right", from: [-1, 0, 0.0001], up: [0, 1, 0] },
  above: { title: "Above", from: [0, 1, 0.0001], up: [0, 0, -1] },
  below: { title: "Below", from: [0, -1, 0.0001], up: [0, 0, 1] },
  oblique: { title: "Oblique", from: [0.6, 0.25, 0.75], up: [0, 1, 0] },
};

/** What the button of a direction says: a body's left and right are the patient's. */
export function directionTitle(name: string, ofPatient: boolean): string {
  const { title } = DIRECTIONS[name]!;
  return ofPatient && (name === "left" || name === "right") ? `Patient’s ${name}` : title;
}

/** "photograph", "shaded", or a layer's name. */
export type Look = string;

export interface Section {
  /** 0, 1 or 2: across, height, depth; null draws everything. */
  axis: number | null;
  /** Where, as a share of the model's extent; what lies beyond it towards the positive end is left out. */
  share: number;
}

export interface Hit {
  point: Vector3;
  vertex: number;
  face: number;
}

const SKIN: ColorRepresentation = "#d8c3b4";
const WALL: ColorRepresentation = "#5b8fb9";
const MARK: ColorRepresentation = "#d55e00";
const WAY: ColorRepresentation = "#0072b2";
const OTHER: ColorRepresentation = "#56b4e9";
const CHOSEN: ColorRepresentation = "#f0e442";
const MARGIN = 1.08;
const SEEN_MM = 4;
const IN_WINDOW = 0.9; // share of the picture's height that is seen, where no point is asked for: its rim shows no skin
const WRONG: ColorRepresentation = "#d4001a";
const LIFT_MM = 2; // lines and points stand before the skin that they lie on
const DASH_MM = 4;
const CLOSE_UP = 1.6; // extent of the picture over that of what is looked at

export class Stage {
  readonly canvas: HTMLCanvasElement;
  /** Called after the reader has turned, moved or zoomed this picture. */
  onMoved: () => void = () => {};

  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new OrthographicCamera(-1, 1, 1, -1, -5000, 5000);
  private readonly controls: OrbitControls;
  private readonly lamp = new DirectionalLight("#ffffff", 2.2);
  private readonly raycaster = new Raycaster();
  private readonly clipping = new Plane(new Vector3(-1, 0, 0), 0);
  private readonly marks = new Group();
  private readonly boundary = new Group();
  private readonly landmarks = new Group();
  private readonly lengths: Lengths;
  private readonly box = new Box3();
  private readonly lines: Line2[] = [];
  private readonly skin: Mesh<BufferGeometry, MeshBasicMaterial | MeshLambertMaterial>;
  private readonly wall: Mesh | null = null;
  private tape: Skin | null = null;
  private readonly resized = new ResizeObserver(() => this.fit());
  private pending = 0;
  private section: Section = { axis: null, share: 1 };

  constructor(
    holder: HTMLElement,
    readonly model: Model,
  ) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.localClippingEnabled = true;
    this.canvas = holder.appendChild(this.renderer.domElement);
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${model.title}: three-dimensional view`);

    this.skin = new Mesh(geometryOf(model), this.shaded());
    this.skin.geometry.computeBoundingBox();
    this.box.copy(this.skin.geometry.boundingBox!);
    if (model.wall !== null) {
      const material = new MeshLambertMaterial({ color: WALL, side: DoubleSide, clippingPlanes: [] });
      this.wall = new Mesh(geometryOf(model.wall), material);
      this.wall.visible = false;
      this.scene.add(this.wall);
    }
    for (const curve of model.curves) {
      const points = curve.closed ? [...curve.points, curve.points[0]!] : curve.points;
      // White within black is seen on every ground.
      this.boundary.add(...this.line(points, "#000000", 4.5), ...this.line(points, "#ffffff", 2));
    }
    this.landmarks.add(dots(model.landmarks.map((landmark) => landmark.point), MARK, 9));
    this.lengths = new Lengths(holder, model.lengths);
    this.lamp.position.set(0.3, 0.5, 1);
    this.camera.add(this.lamp);
    this.scene.add(this.camera, new AmbientLight("#ffffff", 0.9), this.skin, this.boundary, this.landmarks, this.marks);

    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => {
      this.draw();
      this.onMoved();
    });
    this.resized.observe(holder);
    this.face("front");
  }

  /** Colours of the skin. */
  async look(look: Look): Promise<void> {
    const { model } = this;
    const layer = this.layer(look);
    let material: MeshBasicMaterial | MeshLambertMaterial;
    if (layer !== undefined) {
      this.paint(layerColours(layer));
      material = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide });
    } else if (look === "photograph" && model.texture !== null) {
      const map = await new TextureLoader().loadAsync(model.texture.image);
      map.colorSpace = SRGBColorSpace;
      map.flipY = false;
      map.anisotropy = this.renderer.capabilities.getMaxAnisotropy();
      material = new MeshBasicMaterial({ map, side: DoubleSide });
    } else if (look === "photograph" && model.colours !== null) {
      this.paint(linear(model.colours));
      material = new MeshBasicMaterial({ vertexColors: true, side: DoubleSide });
    } else material = this.shaded();
    const old = this.skin.material;
    this.skin.material = material;
    if (old !== material) old.dispose();
    this.cut(this.section);
  }

  layer(name: string): Layer | undefined {
    return this.model.layers.find((layer) => layer.name === name);
  }

  showBoundary(shown: boolean): void {
    this.boundary.visible = this.landmarks.visible = shown;
    this.draw();
  }

  showLengths(shown: boolean): void {
    this.lengths.show(shown);
  }

  showWall(shown: boolean): void {
    if (this.wall !== null) this.wall.visible = shown;
    this.draw();
  }

  /** Leave out everything beyond a plane. Returns where it lies, mm. */
  cut(section: Section): number {
    this.section = section;
    const axis = section.axis ?? 0;
    const low = this.box.min.getComponent(axis);
    const at = low + section.share * (this.box.max.getComponent(axis) - low);
    this.clipping.normal.set(0, 0, 0).setComponent(axis, -1);
    this.clipping.constant = at;
    const planes = section.axis === null ? [] : [this.clipping];
    for (const mesh of [this.skin, this.wall]) {
      if (mesh === null) continue;
      const material = mesh.material as MeshLambertMaterial;
      material.clippingPlanes = planes;
      material.needsUpdate = true;
    }
    this.draw();
    return at;
  }

  /** Frame another box than the model's own: that of two models, so that both are drawn at one scale and place. */
  frame(box: Box3): void {
    this.box.copy(box);
    this.face("front");
  }

  get extent(): Box3 {
    return this.box.clone();
  }

  /** Look from one of the named directions, the model filling the picture. */
  face(name: string): void {
    const direction = DIRECTIONS[name]!;
    this.box.getCenter(this.controls.target);
    this.camera.up.set(...direction.up);
    this.camera.position.set(...direction.from).normalize().multiplyScalar(1000).add(this.controls.target);
    this.camera.zoom = 1;
    this.controls.update();
    this.camera.updateMatrix();
    this.fit();
    this.onMoved();
  }

  /** Look at a few points from a direction, near enough for them to fill the picture. */
  approach(points: Vector[], from: Vector): void {
    const box = new Box3().setFromPoints(points.map((point) => new Vector3(...point)));
    box.getCenter(this.controls.target);
    this.camera.up.set(0, 1, 0);
    this.camera.position.set(...from).normalize().multiplyScalar(1000).add(this.controls.target);
    this.camera.zoom = 1;
    this.controls.update();
    this.camera.updateMatrixWorld();
    this.fit();
    const half = [0.1, 0.1];
    for (const point of points) {
      const seen = new Vector3(...point).applyMatrix4(this.camera.matrixWorldInverse);
      half[0] = Math.max(half[0]!, Math.abs(seen.x));
      half[1] = Math.max(half[1]!, Math.abs(seen.y));
    }
    this.camera.zoom = Math.max(1, Math.min(this.camera.right / half[0]!, this.camera.top / half[1]!) / CLOSE_UP);
    this.camera.updateProjectionMatrix();
    this.draw();
    this.onMoved();
  }

  /** Turn around the model, radians, and zoom. */
  turn(right: number, up: number, zoom = 1): void {
    const arm = this.camera.position.clone().sub(this.controls.target);
    const side = new Vector3().crossVectors(this.camera.up, arm).normalize();
    arm.applyAxisAngle(this.camera.up.clone().normalize(), right);
    const tilted = arm.clone().applyAxisAngle(side, -up);
    if (tilted.angleTo(this.camera.up) > 0.02 && tilted.angleTo(this.camera.up) < Math.PI - 0.02) arm.copy(tilted);
    this.camera.position.copy(this.controls.target).add(arm);
    this.camera.zoom *= zoom;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.onMoved();
  }

  /** Take over another picture's point of view, relative to each model's middle. */
  follow(other: Stage): void {
    const arm = other.camera.position.clone().sub(other.controls.target);
    const off = other.controls.target.clone().sub(other.box.getCenter(new Vector3()));
    this.box.getCenter(this.controls.target).add(off);
    this.camera.up.copy(other.camera.up);
    this.camera.position.copy(this.controls.target).add(arm);
    this.camera.zoom = other.camera.zoom;
    this.camera.updateProjectionMatrix();
    const moved = this.onMoved;
    this.onMoved = () => {};
    this.controls.update();
    this.onMoved = moved;
    this.draw();
  }

  /** What of the skin lies under a point of the window. */
  pick(clientX: number, clientY: number): Hit | null {
    const frame = this.canvas.getBoundingClientRect();
    const at = new Vector2(
      (2 * (clientX - frame.left)) / frame.width - 1,
      1 - (2 * (clientY - frame.top)) / frame.height,
    );
    this.raycaster.setFromCamera(at, this.camera);
    const hits = this.raycaster.intersectObject(this.skin, false);
    const hit = hits.find(({ point }) => this.section.axis === null || this.clipping.distanceToPoint(point) >= 0);
    if (hit?.face == null || hit.faceIndex == null) return null;
    const corners = [hit.face.a, hit.face.b, hit.face.c];
    const away = (corner: number) =>
      hit.point.distanceToSquared(new Vector3().fromArray(this.model.positions, 3 * corner));
    const vertex = corners.reduce((best, corner) => (away(corner) < away(best) ? corner : best));
    return { point: hit.point, vertex, face: hit.faceIndex };
  }

  /** Mark points, joined by a straight line where asked for, and a way over the skin. */
  mark(points: Vector3[], joined: boolean, way: Vector[] = []): void {
    this.empty(this.marks);
    const places = points.map((point) => point.toArray());
    if (way.length > 1) this.marks.add(...this.line(way, "#ffffff", 4.5), ...this.line(way, WAY, 2.5));
    if (points.length > 0) this.marks.add(dots(places, MARK, 10));
    if (joined && points.length > 1) this.marks.add(this.through(places, MARK, 2.5));
    this.draw();
  }

  /** The shortest way over the skin; null where none leads there. */
  way(start: Hit, stop: Hit): Way | null {
    this.tape ??= new Skin(this.model);
    const [from, to] = [start, stop].map(({ point, face }): Place => ({ point: point.toArray(), face }));
    return this.tape.way(from!, to!);
  }

  /** Where a point of the model is drawn in the window. */
  onScreen(point: Vector3): [number, number] {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = this.onPicture(point);
    return [left + x, top + y];
  }

  /** Where a point of the model is drawn in the picture, px from its upper left corner. */
  private onPicture(point: Vector3): [number, number] {
    const { clientWidth, clientHeight } = this.canvas;
    const { x, y } = point.clone().project(this.camera);
    return [((x + 1) / 2) * clientWidth, ((1 - y) / 2) * clientHeight];
  }

  /** Whether a point on the surface is on the side that is seen. */
  isSeen(point: Vector3): boolean {
    const hit = this.pick(...this.onScreen(point));
    return hit === null || hit.point.distanceTo(point) < SEEN_MM;
  }

  /** Whether the picture and these points of the model are in the window, and nothing that sticks there is before them. */
  isInWindow(points: Vector[]): boolean {
    const { left, top, right, bottom } = this.canvas.getBoundingClientRect();
    const head = document.querySelector("header.top")?.getBoundingClientRect().bottom ?? 0;
    const foot = stuckBelow(this.canvas);
    const low = Math.max(top, head);
    const high = Math.min(bottom, foot);
    if (points.length === 0) return high - low > IN_WINDOW * (bottom - top);
    const places = points.map((point) => this.onScreen(new Vector3(...point)));
    return places.every(([x, y]) => x >= left && x <= right && x <= window.innerWidth && y >= low && y <= high);
  }

  /** Keep the model where it is while something on it is dragged. */
  holdStill(still: boolean): void {
    this.controls.enabled = !still;
  }

  /** Draw other lines in the place of the model's curves. */
  drawLines(lines: { points: Vector[]; closed: boolean; bold: boolean }[]): void {
    this.empty(this.boundary);
    for (const { points, closed, bold } of lines) {
      if (points.length < 2) continue;
      const corners = closed ? [...points, points[0]!] : points;
      this.boundary.add(...this.line(corners, "#000000", bold ? 5 : 3), ...this.line(corners, "#ffffff", bold ? 2.5 : 1.2));
    }
    this.draw();
  }

  /** Draw points to take hold of, one of them chosen, others that only mark a place, and places that are wrong. */
  drawHandles(handles: Vector[], chosen: number | null, others: Vector[], wrong: Vector[] = []): void {
    this.empty(this.marks);
    const onSkin = [dots(others, OTHER, 8), dots(handles, "#000000", 13), dots(handles, MARK, 9)];
    const place = chosen === null ? undefined : handles[chosen];
    if (place !== undefined) onSkin.push(dots([place], CHOSEN, 9));
    for (const drawn of onSkin) drawn.material.depthTest = true; // what skin hides cannot be taken hold of
    this.marks.add(...onSkin, dots(wrong, "#ffffff", 24), dots(wrong, WRONG, 19));
    this.draw();
  }

  /** The picture as it stands, as a PNG. */
  picture(): Promise<Blob | null> {
    this.renderer.render(this.scene, this.camera);
    return new Promise((done) => this.canvas.toBlob(done, "image/png"));
  }

  /** Give back what the graphics card holds. */
  dispose(): void {
    cancelAnimationFrame(this.pending);
    this.resized.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  draw(): void {
    if (this.pending !== 0) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      const lift = this.camera.position.clone().sub(this.controls.target).setLength(LIFT_MM);
      this.boundary.position.copy(lift);
      this.marks.position.copy(lift.multiplyScalar(2));
      this.renderer.render(this.scene, this.camera);
      this.lengths.place((point) => this.onPicture(new Vector3(...point)));
    });
  }

  /** Take everything out of a group and off the graphics card. */
  private empty(group: Group): void {
    for (const drawn of group.children as (Line2 | Points)[]) {
      drawn.geometry.dispose();
      (drawn.material as LineMaterial | PointsMaterial).dispose();
      if (drawn instanceof Line2) this.lines.splice(this.lines.indexOf(drawn), 1);
    }
    group.clear();
  }

  private shaded(): MeshLambertMaterial {
    return new MeshLambertMaterial({ color: SKIN, side: DoubleSide });
  }

  private paint(colours: Float32Array): void {
    this.skin.geometry.setAttribute("color", new BufferAttribute(colours, 3));
  }

  /** Let the model, seen from where the camera stands, fill the canvas at zoom 1. */
  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement!;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height, true);
    for (const drawn of this.lines) drawn.material.resolution.set(width, height);
    const half = this.box.getSize(new Vector3()).multiplyScalar(MARGIN / 2);
    const [right, up] = [0, 1].map((column) => {
      const axis = new Vector3().setFromMatrixColumn(this.camera.matrix, column);
      return Math.abs(axis.x) * half.x + Math.abs(axis.y) * half.y + Math.abs(axis.z) * half.z;
    }) as [number, number];
    const vertical = Math.max(up, (right * height) / width);
    this.camera.top = vertical;
    this.camera.bottom = -vertical;
    this.camera.right = (vertical * width) / height;
    this.camera.left = -this.camera.right;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** A line on the skin: dashed where skin hides it. */
  private line(points: Vector[], colour: ColorRepresentation, width: number): Line2[] {
    const hidden = { depthFunc: GreaterDepth, dashed: true, dashSize: DASH_MM, gapSize: DASH_MM };
    return [this.drawn(points, colour, 0.7 * width, hidden), this.drawn(points, colour, width, {})];
  }

  /** A line that is seen through the skin. */
  private through(points: Vector[], colour: ColorRepresentation, width: number): Line2 {
    return this.drawn(points, colour, width, { depthTest: false });
  }

  private drawn(points: Vector[], color: ColorRepresentation, linewidth: number, more: LineMaterialParameters): Line2 {
    const geometry = new LineGeometry().setPositions(points.flat());
    const material = new LineMaterial({ color, linewidth, depthWrite: false, transparent: true, ...more });
    const { clientWidth, clientHeight } = this.canvas;
    material.resolution.set(clientWidth || 1, clientHeight || 1);
    const drawn = new Line2(geometry, material).computeLineDistances();
    drawn.renderOrder = 1;
    this.lines.push(drawn);
    return drawn;
  }
}

/** Where the window ends below a picture: at its lower edge, or at buttons that stick there. */
function stuckBelow(canvas: HTMLElement): number {
  const bar = canvas.parentElement!.parentElement!.querySelector(".mm-do");
  if (bar === null || getComputedStyle(bar).position !== "sticky") return window.innerHeight;
  return Math.min(window.innerHeight, bar.getBoundingClientRect().top);
}

function geometryOf(surface: Surface): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(surface.positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(surface.normals, 3));
  const texture = "texture" in surface ? (surface as Model).texture : null;
  if (texture !== null) geometry.setAttribute("uv", new BufferAttribute(texture.uv, 2));
  geometry.setIndex(new BufferAttribute(surface.faces, 1));
  return geometry;
}

/** Round dots of a fixed size on the screen. */
function dots(points: Vector[], colour: ColorRepresentation, size: number): Points<BufferGeometry, PointsMaterial> {
  const geometry = new BufferGeometry().setFromPoints(points.map((point) => new Vector3(...point)));
  const disc = document.createElement("canvas");
  disc.width = disc.height = 32;
  const pen = disc.getContext("2d")!;
  pen.fillStyle = "#ffffff";
  pen.beginPath();
  pen.arc(16, 16, 15, 0, 2 * Math.PI);
  pen.fill();
  const material = new PointsMaterial({
    color: colour,
    size: size * Math.min(window.devicePixelRatio, 2),
    sizeAttenuation: false,
    map: new CanvasTexture(disc),
    alphaTest: 0.5,
    depthTest: false,
    transparent: true,
  });
  const drawn = new Points(geometry, material);
  drawn.renderOrder = 2;
  return drawn;
}

function linear(colours: Uint8Array): Float32Array {
  const table = Float32Array.from({ length: 256 }, (_, code) => {
    const value = code / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return Float32Array.from(colours, (code) => table[code]!);
}
