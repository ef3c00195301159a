/** What the page brings along: models as compact buffers, in millimetres, in the viewing frame (x right, y up, z towards the reader). */

import type { Length } from "./lengths";

export type Vector = [number, number, number];

/** Base64 of a zlib stream. */
type Packed = string;

export interface PackedSurface {
  vertexCount: number;
  /** Position = low + step · integer. */
  low: Vector;
  step: Vector;
  /** uint16, three a vertex. */
  positions: Packed;
  /** int8, three a vertex: unit normals · 127. */
  normals: Packed;
  /** Corners of all triangles: zigzag-coded differences, uint32. */
  faces: Packed;
}

export interface Category {
  title: string;
  colour: string;
}

export interface PackedLayer {
  name: string;
  title: string;
  /** One sentence on how to read it. */
  help: string;
  kind: "category" | "sequential" | "diverging";
  unit: string;
  low: number;
  high: number;
  categories: Category[];
  /** category: uint8; else uint16 from low to high, 65535 where there is no value. */
  values: Packed;
}

export interface Curve {
  title: string;
  points: Vector[];
  closed: boolean;
}

export interface Landmark {
  title: string;
  point: Vector;
}

export interface PackedModel extends PackedSurface {
  name: string;
  title: string;
  /** uint8, three a vertex, sRGB; null where there is a texture, or no colour at all. */
  colours: Packed | null;
  texture: { uv: Packed; image: string } | null;
  layers: PackedLayer[];
  curves: Curve[];
  landmarks: Landmark[];
  lengths: Length[];
  wall: PackedSurface | null;
}

export interface Comparison {
  title: string;
  first: string;
  second: string;
}

export interface PackedScene {
  version: 1;
  /** Viewing frame to world frame: 4 × 4, row by row. */
  worldFromView: number[];
  models: PackedModel[];
  comparisons: Comparison[];
  /** It shows a body: its sides are the patient's, and its wall is a chest's. */
  ofPatient: boolean;
}

export interface Surface {
  positions: Float32Array;
  normals: Float32Array;
  faces: Uint32Array;
}

export interface Layer extends Omit<PackedLayer, "values"> {
  /** Category number, or value in `unit`; NaN where there is none. */
  values: Float32Array;
}

export interface Model extends Surface {
  name: string;
  title: string;
  colours: Uint8Array | null;
  texture: { uv: Float32Array; image: string } | null;
  layers: Layer[];
  curves: Curve[];
  landmarks: Landmark[];
  lengths: Length[];
  wall: Surface | null;
}

export async function unpackModel(packed: PackedModel): Promise<Model> {
  const [surface, colours, uv, wall, layers] = await Promise.all([
    unpackSurface(packed),
    packed.colours === null ? null : inflate(packed.colours),
    packed.texture === null ? null : inflate(packed.texture.uv),
    packed.wall === null ? null : unpackSurface(packed.wall),
    Promise.all(packed.layers.map(unpackLayer)),
  ]);
  return {
    ...surface,
    name: packed.name,
    title: packed.title,
    colours,
    texture:
      uv === null || packed.texture === null
        ? null
        : { uv: Float32Array.from(new Uint16Array(uv.buffer), (value) => value / 65535), image: packed.texture.image },
    layers,
    curves: packed.curves,
    landmarks: packed.landmarks,
    lengths: packed.lengths ?? [],
    wall,
  };
}

async function unpackSurface(packed: PackedSurface): Promise<Surface> {
  const [positions, normals, faces] = await Promise.all([
    inflate(packed.positions),
    inflate(packed.normals),
    inflate(packed.faces),
  ]);
  const steps = new Uint16Array(positions.buffer);
  const differences = new Uint32Array(faces.buffer);
  const corners = new Uint32Array(differences.length);
  let corner = 0;
  differences.forEach((coded, k) => {
    corner += (coded >>> 1) ^ -(coded & 1);
    corners[k] = corner;
  });
  return {
    positions: Float32Array.from(steps, (value, k) => packed.low[k % 3]! + packed.step[k % 3]! * value),
    normals: Float32Array.from(new Int8Array(normals.buffer), (value) => value / 127),
    faces: corners,
  };
}

async function unpackLayer(packed: PackedLayer): Promise<Layer> {
  const bytes = await inflate(packed.values);
  const span = packed.high - packed.low;
  const values =
    packed.kind === "category"
      ? Float32Array.from(bytes)
      : Float32Array.from(new Uint16Array(bytes.buffer), (value) =>
          value === 65535 ? Number.NaN : packed.low + (span * value) / 65534,
        );
  return { ...packed, values };
}

async function inflate(packed: Packed): Promise<Uint8Array<ArrayBuffer>> {
  const compressed = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
