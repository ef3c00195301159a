/** What is drawn on the page: sketches by name, what of them is saved, and the steps back. */

import type { PackedScene, Vector } from "../format";

export type Group = "boundaries" | "landmarks";

/** A point to take hold of; `at` says which point of the curve it began from it is, where nobody moved it. */
export interface Handle {
  point: Vector;
  at: number | null;
}

/** A drawn item: the curve it began from, and where its handles are now. */
export interface Sketch {
  of: string | null;
  handles: Handle[];
}

type Sketches = Record<Group, Record<string, Sketch>>;

export interface LiveVolume {
  curve: Vector[];
  volumeCc: number | null;
  intervalCc: [number, number] | null;
  problem: string | null;
  crossings: Vector[];
  /** Of the thinned surface, not yet of the full measurement. */
  preliminary: boolean;
}

interface Stored {
  base: string | null;
  how: string | null;
}

export interface StoredBoundary extends Stored {
  /** Digest of the curve. */
  of?: string;
  curve?: Vector[];
  handles?: Handle[];
  confirmed?: { by: string; at: string; holds: boolean } | null;
  /** What was measured last, and the digest of its curve. */
  measured?: LiveVolume & { of: string };
}

export interface StoredPlace extends Stored {
  points: Vector[];
  /** Where the measurement proposes it, until somebody picks it. */
  proposed: Vector[];
}

export interface Job {
  state: string;
  stage_words: string;
  fraction: number | null;
  message: string;
}

/** What stands in the session. */
export interface State {
  breasts: string[];
  landmarks: { name: string; title: string; kind: "point" | "line" }[];
  boundaries: Record<string, StoredBoundary>;
  places: Record<string, StoredPlace>;
  remark: string;
  /** The visit's newest job. Undefined: no clinic measures it. */
  job?: Job | null;
}

export interface Page extends State {
  scene: PackedScene;
  author: string;
  /** The server knows who draws: the page does not ask. */
  signed: boolean;
}

export interface Item {
  group: Group;
  name: string;
  title: string;
  kind: "closed" | "line" | "point";
}

const TITLES: Record<string, string> = { model: "Boundary", left: "Left breast", right: "Right breast" };

export class Drawing {
  readonly items: Item[];
  state: State;
  private sketches: Sketches = { boundaries: {}, landmarks: {} };
  private saved: Sketches = this.sketches;
  private past: Sketches[] = [];
  private future: Sketches[] = [];

  constructor(state: State) {
    this.state = state;
    this.items = [
      ...state.breasts.map((name): Item => ({ group: "boundaries", name, title: TITLES[name]!, kind: "closed" })),
      ...state.landmarks.map((mark): Item => ({ group: "landmarks", ...mark, title: capitalised(mark.title) })),
    ];
    for (const item of this.items) this.take(item, state);
  }

  sketch({ group, name }: Item): Sketch | undefined {
    return this.sketches[group][name];
  }

  handles(item: Item): Handle[] {
    return this.sketch(item)?.handles ?? [];
  }

  stored({ group, name }: Item, state = this.state): Stored {
    return group === "boundaries" ? state.boundaries[name]! : state.places[name]!;
  }

  /** Where a landmark is proposed that nobody has picked. */
  proposed(item: Item): Vector[] {
    return item.group === "boundaries" || this.handles(item).length > 0 ? [] : this.state.places[item.name]!.proposed;
  }

  isChanged({ group, name }: Item): boolean {
    return JSON.stringify(this.sketches[group][name]) !== JSON.stringify(this.saved[group][name]);
  }

  get changed(): Item[] {
    return this.items.filter((item) => this.isChanged(item));
  }

  /** Take a step: what was there before can be had back. */
  change(item: Item, handles: Handle[]): void {
    this.step(this.sketches);
    this.replace(item, handles);
  }

  /** Show other points without a step, as while a point is dragged. */
  replace(item: Item, handles: Handle[]): void {
    const of = this.sketch(item)?.of ?? null;
    this.sketches = withItem(this.sketches, item, handles.length === 0 ? undefined : { of, handles });
  }

  /** All sketches as they are now, for `step`. */
  get now(): Sketches {
    return this.sketches;
  }

  /** Remember what was there before a change. */
  step(before: Sketches): void {
    this.past.push(before);
    this.future.length = 0;
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  undo(): void {
    this.back(this.past, this.future);
  }

  redo(): void {
    this.back(this.future, this.past);
  }

  private back(from: Sketches[], to: Sketches[]): void {
    const other = from.pop();
    if (other === undefined) return;
    to.push(this.sketches);
    this.sketches = other;
  }

  /** The body of a request that saves these items. */
  body(items: Item[]): { boundaries: Record<string, object>; landmarks: Record<string, object> } {
    const body: { boundaries: Record<string, object>; landmarks: Record<string, object> } = { boundaries: {}, landmarks: {} };
    for (const item of items) {
      const { base } = this.stored(item);
      const sketch = this.sketch(item);
      body[item.group][item.name] =
        item.group === "boundaries" ? { base, sketch: sketch ?? null } : { base, points: sketch === undefined ? null : points(sketch.handles) };
    }
    return body;
  }

  /** Versions of all items: name → digest. */
  get bases(): Record<Group, Record<string, string | null>> {
    const bases: Record<Group, Record<string, string | null>> = { boundaries: {}, landmarks: {} };
    for (const item of this.items) bases[item.group][item.name] = this.stored(item).base;
    return bases;
  }

  /** Show an item as it stands in the session, in every step that may be had back too. */
  take(item: Item, state: State): void {
    const { group, name } = item;
    let sketch: Sketch | undefined;
    if (group === "boundaries") {
      const stored = state.boundaries[name]!;
      if (stored.curve !== undefined) sketch = { of: stored.of!, handles: stored.handles! };
    } else {
      const stored = state.places[name]!;
      if (stored.points.length > 0) sketch = { of: null, handles: stored.points.map((point) => ({ point, at: null })) };
    }
    this.saved = withItem(this.saved, item, sketch);
    this.sketches = withItem(this.sketches, item, sketch);
    this.past = this.past.map((step) => withItem(step, item, sketch));
    this.future = this.future.map((step) => withItem(step, item, sketch));
  }

  /** Take over what stands in the session now, but for what was changed here and not sent. */
  hear(state: State, sent: Item[] = []): void {
    const before = this.state;
    const kept = this.changed.filter((item) => !sent.includes(item));
    this.state = state;
    for (const item of this.items) {
      const moved = this.stored(item, state).base !== this.stored(item, before).base;
      const other = item.group === "boundaries" && state.boundaries[item.name]!.of !== before.boundaries[item.name]!.of;
      if (kept.includes(item)) this.keepBase(item, before);
      else if (sent.includes(item) || moved || other) this.take(item, state);
    }
  }

  /** What is changed here was begun from what stood there before: saving it tells who was faster. */
  private keepBase(item: Item, before: State): void {
    this.stored(item).base = this.stored(item, before).base;
  }
}

export function points(handles: Handle[]): Vector[] {
  return handles.map(({ point }) => point);
}

/** Before which point of a closed curve a new one belongs: where it makes the curve longer by least. */
export function cheapestPlace(corners: Vector[], point: Vector): number {
  const away = (a: Vector, b: Vector): number => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  let best = 0;
  let least = Number.POSITIVE_INFINITY;
  corners.forEach((from, k) => {
    const to = corners[(k + 1) % corners.length]!;
    const longer = away(from, point) + away(point, to) - away(from, to);
    if (longer < least) [best, least] = [k + 1, longer];
  });
  return best;
}

function withItem(sketches: Sketches, { group, name }: Item, sketch: Sketch | undefined): Sketches {
  const items = { ...sketches[group] };
  if (sketch === undefined) delete items[name];
  else items[name] = sketch;
  return { ...sketches, [group]: items };
}

function capitalised(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}
