/** The editor: boundaries and landmarks are drawn on the surface with the mouse, and measured as they are drawn. */

import { Matrix4, Vector3 } from "three";

import { number } from "./colours";
import { type PackedScene, type Vector, unpackModel } from "./format";
import { DIRECTIONS, Stage } from "./stage";
import { button, choose, element } from "./viewer";

type Places = Record<string, Vector[]>;

interface Drawn {
  boundaries: Places;
  landmarks: Places;
}

interface Drawing {
  scene: PackedScene;
  breasts: string[];
  landmarks: { name: string; title: string; kind: "point" | "line" }[];
  drawn: Drawn;
  byHand: boolean;
}

interface LiveVolume {
  curve: Vector[];
  volumeCc: number | null;
  intervalCc: [number, number] | null;
  problem: string | null;
}

interface Thing {
  group: keyof Drawn;
  name: string;
  title: string;
  kind: "closed" | "line" | "point";
}

const GRAB_PX = 12;
const CLICK_PX = 4;
const PAUSE_MS = 120;
const TITLES: Record<string, string> = { model: "boundary", left: "left boundary", right: "right boundary" };

class Editor {
  private readonly stage: Stage;
  private readonly worldFromView: Matrix4;
  private readonly viewFromWorld: Matrix4;
  private readonly things: Thing[];
  private readonly select: HTMLSelectElement;
  private readonly buttons: Record<"undo" | "redo" | "remove" | "clear" | "save", HTMLButtonElement>;
  private readonly volumes: HTMLElement;
  private readonly readout: HTMLElement;
  private drawn: Drawn;
  private readonly past: Drawn[] = [];
  private readonly future: Drawn[] = [];
  private saved: string;
  private curves: Places = {};
  private chosen: number | null = null;
  private timer = 0;
  private asked = 0;

  private constructor(root: HTMLElement, drawing: Drawing, stage: (holder: HTMLElement) => Stage) {
    this.worldFromView = new Matrix4().fromArray(drawing.scene.worldFromView).transpose();
    this.viewFromWorld = this.worldFromView.clone().invert();
    this.drawn = drawing.drawn;
    this.saved = drawing.byHand ? JSON.stringify(this.drawn) : "";
    this.things = [
      ...drawing.breasts.map((name): Thing => ({ group: "boundaries", name, title: TITLES[name]!, kind: "closed" })),
      ...drawing.landmarks.map((mark): Thing => ({ group: "landmarks", ...mark })),
    ];
    root.replaceChildren();
    const bar = element(root, "div", "mm-bar-row");
    this.select = choose(
      bar,
      "Draw",
      this.things.map((thing, k) => [String(k), thing.title]),
    );
    this.select.onchange = () => {
      this.chosen = null;
      this.show();
    };
    this.buttons = {
      undo: button(bar, "Undo", "Undo (Ctrl+Z)", () => this.back(this.past, this.future)),
      redo: button(bar, "Redo", "Redo (Ctrl+Shift+Z)", () => this.back(this.future, this.past)),
      remove: button(bar, "Remove point", "Remove the chosen point (Delete)", () => this.remove()),
      clear: button(bar, "Start anew", "Remove all points of what is being drawn", () => this.clear()),
      save: button(bar, "Save", "Save into the session (Ctrl+S)", () => void this.save()),
    };
    this.buttons.save.classList.add("mm-save");
    this.volumes = element(root, "div", "mm-volumes");
    const views = element(root, "div", "mm-bar-row");
    for (const [name, { title }] of Object.entries(DIRECTIONS))
      button(views, title, "Look from there", () => this.stage.face(name));
    const looks = choose(views, "Colour", [
      ["photograph", "photograph"],
      ["shaded", "shaded"],
      ["provenance", "where it comes from"],
    ]);
    this.stage = stage(element(root, "div", "mm-canvas"));
    looks.onchange = () => void this.stage.look(looks.value);
    void this.stage.look("photograph");
    this.readout = element(root, "p", "mm-readout");
    this.readout.setAttribute("role", "status");
    this.listen();
    this.say("");
    this.show();
    this.measure();
  }

  static async create(root: HTMLElement): Promise<Editor> {
    const drawing = (await (await fetch("drawing")).json()) as Drawing;
    const model = await unpackModel(drawing.scene.models[0]!);
    return new Editor(root, drawing, (holder) => new Stage(holder, model));
  }

  /** Points of what is being drawn, world frame. */
  private get points(): Vector[] {
    return this.drawn[this.thing.group][this.thing.name] ?? [];
  }

  private get thing(): Thing {
    return this.things[Number(this.select.value)]!;
  }

  /** Take a step: what was there before can be had back. */
  private change(points: Vector[]): void {
    this.past.push(this.drawn);
    this.future.length = 0;
    this.replace(points);
  }

  /** Show other points without a step, as while a point is dragged. */
  private replace(points: Vector[]): void {
    const { group, name } = this.thing;
    const places = { ...this.drawn[group], [name]: points };
    if (points.length === 0) delete places[name];
    this.drawn = { ...this.drawn, [group]: places };
    this.changed();
  }

  private back(from: Drawn[], to: Drawn[]): void {
    const other = from.pop();
    if (other === undefined) return;
    to.push(this.drawn);
    this.drawn = other;
    this.chosen = null;
    this.changed();
  }

  private remove(): void {
    if (this.chosen === null) return;
    const chosen = this.chosen;
    this.chosen = null;
    this.change(this.points.filter((_, k) => k !== chosen));
  }

  private clear(): void {
    this.chosen = null;
    if (this.points.length > 0) this.change([]);
  }

  private changed(): void {
    this.show();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.measure(), PAUSE_MS);
  }

  private show(): void {
    const view = (points: Vector[]) => points.map((point) => this.seen(point));
    const { group, name } = this.thing;
    const lines = Object.entries(this.drawn.boundaries).map(([breast, handles]) => ({
      points: view(this.curves[breast] ?? handles),
      closed: handles.length > 2,
      bold: group === "boundaries" && breast === name,
    }));
    const marks: Vector[] = [];
    for (const [mark, points] of Object.entries(this.drawn.landmarks)) {
      if (points.length > 1) lines.push({ points: view(points), closed: false, bold: mark === name });
      else if (mark !== name) marks.push(...view(points));
    }
    this.stage.drawLines(lines);
    this.stage.drawHandles(view(this.points), this.chosen, marks);
    this.buttons.undo.disabled = this.past.length === 0;
    this.buttons.redo.disabled = this.future.length === 0;
    this.buttons.remove.disabled = this.chosen === null;
    this.buttons.clear.disabled = this.points.length === 0;
    this.buttons.save.dataset.dirty = String(this.dirty);
  }

  private get dirty(): boolean {
    return JSON.stringify(this.drawn) !== this.saved;
  }

  /** Ask what is enclosed; an answer that comes too late is left alone. */
  private async measure(): Promise<void> {
    const question = ++this.asked;
    const boundaries = Object.fromEntries(
      Object.entries(this.drawn.boundaries).filter(([, points]) => points.length > 2),
    );
    if (Object.keys(boundaries).length === 0) {
      this.curves = {};
      this.volumes.replaceChildren();
      this.show();
      return;
    }
    try {
      const found = (await this.post("measure", { boundaries, landmarks: {} })) as Record<string, LiveVolume>;
      if (question !== this.asked) return;
      this.curves = Object.fromEntries(Object.entries(found).map(([name, live]) => [name, live.curve]));
      this.volumes.replaceChildren(...Object.entries(found).map(([name, live]) => volumeWords(name, live)));
      this.volumes.dataset.question = String(question);
      this.show();
    } catch (error) {
      this.say(`Not measured: ${words(error)}`);
    }
  }

  private async save(): Promise<void> {
    const boundaries = Object.fromEntries(
      Object.entries(this.drawn.boundaries).filter(([, points]) => points.length > 2),
    );
    const sent = { boundaries, landmarks: this.drawn.landmarks };
    const state = JSON.stringify(this.drawn);
    try {
      const { saved } = (await this.post("save", sent)) as { saved: string[] };
      this.saved = state;
      this.show();
      this.say(
        saved.length > 0
          ? `Saved ${saved.join(" and ")}; what was there before is in history/. Now run: mammometry run SESSION`
          : "Nothing had changed.",
      );
    } catch (error) {
      this.say(`Not saved: ${words(error)}`);
    }
  }

  private async post(path: string, body: unknown): Promise<unknown> {
    const response = await fetch(path, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    });
    if (!response.ok) {
      const { detail } = (await response.json().catch(() => ({ detail: response.statusText }))) as { detail: unknown };
      throw new Error(typeof detail === "string" ? detail : JSON.stringify(detail));
    }
    return response.json();
  }

  private listen(): void {
    const { canvas } = this.stage;
    let grabbed: { index: number; before: Drawn; moved: boolean } | null = null;
    let pressed: [number, number] | null = null;
    // Before the orbit controls hear of it: a grabbed point moves, the model stays.
    canvas.parentElement!.addEventListener(
      "pointerdown",
      (event) => {
        if (event.button !== 0) return;
        pressed = [event.clientX, event.clientY];
        const index = this.handleAt(event.clientX, event.clientY);
        if (index === null) return;
        this.stage.holdStill(true);
        grabbed = { index, before: this.drawn, moved: false };
        this.chosen = index;
        this.show();
      },
      { capture: true },
    );
    canvas.addEventListener("pointermove", (event) => {
      if (grabbed === null) return;
      const hit = this.stage.pick(event.clientX, event.clientY);
      if (hit === null) return;
      const { index } = grabbed;
      grabbed.moved = true;
      this.replace(this.points.map((point, k) => (k === index ? this.world(hit.point) : point)));
    });
    const release = (event: PointerEvent): void => {
      const held = grabbed;
      grabbed = null;
      this.stage.holdStill(false);
      if (held !== null) {
        if (held.moved) {
          this.past.push(held.before);
          this.future.length = 0;
          this.show();
        }
      } else if (pressed !== null && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < CLICK_PX)
        this.add(event.clientX, event.clientY);
      pressed = null;
    };
    canvas.addEventListener("pointerup", release);
    document.addEventListener("keydown", (event) => {
      const control = event.ctrlKey || event.metaKey;
      const key = event.key.toLowerCase();
      if (control && key === "z") this.buttons[event.shiftKey ? "redo" : "undo"].click();
      else if (control && key === "y") this.buttons.redo.click();
      else if (control && key === "s") void this.save();
      else if (key === "delete" || key === "backspace") this.remove();
      else return;
      event.preventDefault();
    });
    window.addEventListener("beforeunload", (event) => {
      if (this.past.length > 0 && this.dirty) event.preventDefault();
    });
  }

  private add(clientX: number, clientY: number): void {
    const hit = this.stage.pick(clientX, clientY);
    if (hit === null) return;
    const point = this.world(hit.point);
    const { points, thing } = this;
    if (thing.kind === "point") {
      this.chosen = 0;
      this.change([point]);
      return;
    }
    const at = thing.kind === "closed" && points.length > 2 ? cheapestPlace(points, point) : points.length;
    this.chosen = at;
    this.change([...points.slice(0, at), point, ...points.slice(at)]);
  }

  /** The handle under the pointer, on the side that is seen. */
  private handleAt(clientX: number, clientY: number): number | null {
    let best: number | null = null;
    let reach = GRAB_PX;
    this.points.forEach((point, k) => {
      const place = new Vector3(...this.seen(point));
      const [x, y] = this.stage.onScreen(place);
      const away = Math.hypot(clientX - x, clientY - y);
      if (away < reach && this.stage.isSeen(place)) [best, reach] = [k, away];
    });
    return best;
  }

  private world(point: Vector3): Vector {
    return point.clone().applyMatrix4(this.worldFromView).toArray();
  }

  private seen(point: Vector): Vector {
    return new Vector3(...point).applyMatrix4(this.viewFromWorld).toArray();
  }

  private say(text: string): void {
    this.readout.textContent =
      text || "Click the surface to add a point, drag a point to move it, drag beside it to turn the model.";
  }
}

/** Before which point of a closed curve a new one belongs: where it makes the curve longer by least. */
function cheapestPlace(points: Vector[], point: Vector): number {
  const away = (a: Vector, b: Vector): number => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  let best = 0;
  let least = Number.POSITIVE_INFINITY;
  points.forEach((from, k) => {
    const to = points[(k + 1) % points.length]!;
    const longer = away(from, point) + away(point, to) - away(from, to);
    if (longer < least) [best, least] = [k + 1, longer];
  });
  return best;
}

function volumeWords(name: string, live: LiveVolume): HTMLElement {
  const line = document.createElement("span");
  if (live.volumeCc === null) {
    line.className = "mm-problem";
    line.textContent = live.problem ?? "No volume.";
    return line;
  }
  const value = document.createElement("b");
  value.textContent = `${number(live.volumeCc)} cc`;
  line.append(`${name}: `, value);
  if (live.intervalCc !== null) line.append(` (95 %: ${number(live.intervalCc[0])} to ${number(live.intervalCc[1])})`);
  return line;
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

const root = document.getElementById("mm-editor")!;
Editor.create(root).then(
  () => (root.dataset.ready = "1"),
  (error: unknown) => (root.textContent = `The surface cannot be shown: ${words(error)}`),
);
