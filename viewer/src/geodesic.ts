/**
 * Shortest way over a triangulated surface: a tape measure laid on the skin.
 *
 * As `mammometry.measure.geodesic`: points are spread over the edges (Lanthier, Maheshwari and Sack 1997), the shortest
 * way along them is found by Dijkstra's algorithm, then again with more of them in the ever narrower belt that can still
 * hold it. The length is never shorter than the true one on this mesh, and up to half a per cent longer.
 */

import type { Surface, Vector } from "./format";

/** A point of the surface and the face that it lies in. */
export interface Place {
  point: Vector;
  face: number;
}

export interface Way {
  points: Vector[];
  length: number;
}

/** Points an edge, and how much longer than the shortest a way may be to stay in the next round's belt. */
const ROUNDS: [number, number][] = [[0, 1.16], [1, 1.04], [4, 1.006], [12, 1.0]];
/** That much more, in edge lengths. */
const BELT = 0.4;
/** Of points that see one another, at most in a round. */
const PAIRS = 1_500_000;
/** Faces so far off a straight way are not looked at, unless there is no way without them: a share, and mm. */
const ROOM = 2.5;
const ROOM_MM = 60;

/** A surface prepared for measuring along it: corners in one place are one, whatever seams its picture has. */
export class Skin {
  private readonly positions: Float64Array;
  private readonly corners: Uint32Array;

  constructor(surface: Surface) {
    const { positions, faces } = surface;
    const found = new Map<string, number>();
    const joined = new Uint32Array(positions.length / 3);
    const kept: number[] = [];
    for (let vertex = 0; vertex < joined.length; vertex++) {
      const [x, y, z] = positions.subarray(3 * vertex, 3 * vertex + 3) as unknown as Vector;
      const key = `${x},${y},${z}`;
      let number = found.get(key);
      if (number === undefined) {
        number = kept.length / 3;
        found.set(key, number);
        kept.push(x, y, z);
      }
      joined[vertex] = number;
    }
    this.positions = Float64Array.from(kept);
    this.corners = faces.map((vertex) => joined[vertex]!);
  }

  /** The shortest way between two places; null where no way over the surface leads from one to the other. */
  way(start: Place, stop: Place): Way | null {
    if (start.face === stop.face) return { points: [start.point, stop.point], length: distance(start.point, stop.point) };
    const ends: [Place, Place] = [start, stop];
    return this.between(ends, this.near(start, stop)) ?? this.between(ends, everyFace(this.corners.length / 3));
  }

  /** Faces within the ellipsoid about both places that a reasonable way stays in. */
  private near(start: Place, stop: Place): Uint32Array {
    const reach = ROOM * distance(start.point, stop.point) + ROOM_MM;
    const count = this.positions.length / 3;
    const inside = new Uint8Array(count);
    for (let vertex = 0; vertex < count; vertex++) {
      const at = this.at(vertex);
      inside[vertex] = distance(at, start.point) + distance(at, stop.point) <= reach ? 1 : 0;
    }
    return everyFace(this.corners.length / 3).filter(
      (face) =>
        face === start.face ||
        face === stop.face ||
        (inside[this.corners[3 * face]!]! & inside[this.corners[3 * face + 1]!]! & inside[this.corners[3 * face + 2]!]!) === 1,
    );
  }

  private between(ends: [Place, Place], faces: Uint32Array): Way | null {
    const belt = BELT * this.middleEdge(faces);
    let points: Vector[] = [];
    for (const [wanted, slack] of ROUNDS) {
      const fitting = Math.floor(Math.sqrt(PAIRS / (3 * faces.length) + 0.25) - 0.5);
      const graph = new Graph(this.positions, this.corners, faces, Math.min(wanted, Math.max(fitting, 1)));
      const [from, to] = ends.map(({ point, face }) => graph.join(point, faces.indexOf(face))) as [number, number];
      graph.close();
      const forth = graph.distances(from);
      const best = forth.distance[to]!;
      if (!Number.isFinite(best)) return null;
      points = [];
      for (let at = to; at !== -1; at = forth.before[at]!) points.unshift(graph.place(at));
      if (slack > 1) {
        const back = graph.distances(to).distance;
        faces = faces.filter((face, local) => {
          if (face === ends[0].face || face === ends[1].face) return true;
          return graph.nodesOf(local).some((node) => forth.distance[node]! + back[node]! <= best * slack + belt);
        });
      }
    }
    let length = 0;
    for (let k = 1; k < points.length; k++) length += distance(points[k - 1]!, points[k]!);
    return { points, length };
  }

  private middleEdge(faces: Uint32Array): number {
    const lengths = Float64Array.from(faces, (face) =>
      distance(this.at(this.corners[3 * face]!), this.at(this.corners[3 * face + 1]!)),
    ).sort();
    return lengths[lengths.length >> 1]!;
  }

  private at(vertex: number): Vector {
    return [this.positions[3 * vertex]!, this.positions[3 * vertex + 1]!, this.positions[3 * vertex + 2]!];
  }
}

/** Places on the corners and edges of some faces, and which of them see one another within a face. */
class Graph {
  private readonly places: number[] = [];
  private readonly first: number[] = [];
  private readonly second: number[] = [];
  /** Of each face: its corners, then the points of its three sides, side k from corner k to corner k + 1. */
  private readonly nodes: Uint32Array;
  private readonly perFace: number;
  private starts = new Uint32Array(0);
  private targets = new Uint32Array(0);
  private lengths = new Float64Array(0);

  constructor(positions: Float64Array, corners: Uint32Array, faces: Uint32Array, perEdge: number) {
    this.perFace = 3 + 3 * perEdge;
    this.nodes = new Uint32Array(faces.length * this.perFace);
    const vertices = new Map<number, number>();
    const edges = new Map<number, number>();
    const corner = (vertex: number): number => {
      let node = vertices.get(vertex);
      if (node === undefined) {
        node = this.add(positions[3 * vertex]!, positions[3 * vertex + 1]!, positions[3 * vertex + 2]!);
        vertices.set(vertex, node);
      }
      return node;
    };
    const count = positions.length / 3;
    faces.forEach((face, local) => {
      const base = local * this.perFace;
      const own = [0, 1, 2].map((k) => corner(corners[3 * face + k]!));
      own.forEach((node, k) => (this.nodes[base + k] = node));
      for (let side = 0; side < 3; side++) {
        const [a, b] = [corners[3 * face + side]!, corners[3 * face + ((side + 1) % 3)]!];
        const key = Math.min(a, b) * count + Math.max(a, b);
        let start = edges.get(key);
        if (start === undefined) {
          // The edge's points lie one after the other, from its vertex of the smaller number.
          const [low, high] = [vertices.get(Math.min(a, b))!, vertices.get(Math.max(a, b))!];
          start = this.places.length / 3;
          edges.set(key, start);
          for (let k = 1; k <= perEdge; k++) this.between(low, high, k / (perEdge + 1));
          for (let k = 0; k <= perEdge; k++)
            this.pair(k === 0 ? low : start + k - 1, k === perEdge ? high : start + k);
        }
        for (let k = 0; k < perEdge; k++) this.nodes[base + 3 + side * perEdge + k] = start + k;
      }
      const side = (which: number) =>
        this.nodes.subarray(base + 3 + (which % 3) * perEdge, base + 3 + ((which % 3) + 1) * perEdge);
      for (let which = 0; which < 3; which++)
        for (const one of side(which)) {
          this.pair(own[(which + 2) % 3]!, one);
          for (const other of side(which + 1)) this.pair(one, other);
        }
    });
  }

  /** Add a point that lies in a face; returns its number. */
  join(point: Vector, local: number): number {
    const node = this.add(...point);
    for (const other of this.nodesOf(local)) this.pair(node, other);
    return node;
  }

  nodesOf(local: number): Uint32Array {
    return this.nodes.subarray(local * this.perFace, (local + 1) * this.perFace);
  }

  place(node: number): Vector {
    return [this.places[3 * node]!, this.places[3 * node + 1]!, this.places[3 * node + 2]!];
  }

  /** Sort all pairs by their nodes, so that distances can be asked for. */
  close(): void {
    const count = this.places.length / 3;
    this.starts = new Uint32Array(count + 1);
    for (const ends of [this.first, this.second]) for (const node of ends) this.starts[node + 1]!++;
    for (let node = 0; node < count; node++) this.starts[node + 1]! += this.starts[node]!;
    const next = this.starts.slice();
    this.targets = new Uint32Array(2 * this.first.length);
    this.lengths = new Float64Array(2 * this.first.length);
    this.first.forEach((a, k) => {
      const b = this.second[k]!;
      const length = distance(this.place(a), this.place(b));
      for (const [from, to] of [[a, b], [b, a]] as const) {
        const slot = next[from]!++;
        this.targets[slot] = to;
        this.lengths[slot] = length;
      }
    });
  }

  /** Dijkstra's distances of all nodes from one, and each one's predecessor on its shortest way. */
  distances(from: number): { distance: Float64Array; before: Int32Array } {
    const count = this.places.length / 3;
    const found = new Float64Array(count).fill(Infinity);
    const before = new Int32Array(count).fill(-1);
    const heap = new Heap();
    found[from] = 0;
    heap.push(0, from);
    for (let top = heap.pop(); top !== null; top = heap.pop()) {
      const [so_far, node] = top;
      if (so_far > found[node]!) continue;
      for (let slot = this.starts[node]!; slot < this.starts[node + 1]!; slot++) {
        const other = this.targets[slot]!;
        const there = so_far + this.lengths[slot]!;
        if (there < found[other]!) {
          found[other] = there;
          before[other] = node;
          heap.push(there, other);
        }
      }
    }
    return { distance: found, before };
  }

  private add(x: number, y: number, z: number): number {
    this.places.push(x, y, z);
    return this.places.length / 3 - 1;
  }

  private between(a: number, b: number, share: number): void {
    const [from, to] = [this.place(a), this.place(b)];
    this.add(...(from.map((value, k) => value + share * (to[k]! - value)) as Vector));
  }

  private pair(a: number, b: number): void {
    this.first.push(a);
    this.second.push(b);
  }
}

/** A binary heap of keys and what they belong to, the least on top. */
class Heap {
  private readonly keys: number[] = [];
  private readonly values: number[] = [];

  push(key: number, value: number): void {
    let at = this.keys.length;
    while (at > 0) {
      const above = (at - 1) >> 1;
      if (this.keys[above]! <= key) break;
      this.keys[at] = this.keys[above]!;
      this.values[at] = this.values[above]!;
      at = above;
    }
    this.keys[at] = key;
    this.values[at] = value;
  }

  pop(): [number, number] | null {
    if (this.keys.length === 0) return null;
    const top: [number, number] = [this.keys[0]!, this.values[0]!];
    const [key, value] = [this.keys.pop()!, this.values.pop()!];
    const size = this.keys.length;
    if (size > 0) {
      let at = 0;
      for (let below = 1; below < size; below = 2 * at + 1) {
        if (below + 1 < size && this.keys[below + 1]! < this.keys[below]!) below++;
        if (this.keys[below]! >= key) break;
        this.keys[at] = this.keys[below]!;
        this.values[at] = this.values[below]!;
        at = below;
      }
      this.keys[at] = key;
      this.values[at] = value;
    }
    return top;
  }
}

function everyFace(count: number): Uint32Array {
  return Uint32Array.from({ length: count }, (_, face) => face);
}

function distance(a: Vector, b: Vector): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}
