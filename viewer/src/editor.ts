/** The editor: boundaries and landmarks are drawn on the surface with the mouse, and measured as they are drawn. */

import { Matrix4, Vector3 } from "three";

import { Refused, request } from "./clinic/request";
import { number } from "./colours";
import { type PackedScene, type Vector, unpackModel } from "./format";
import { DIRECTIONS, directionTitle, Stage } from "./stage";
import { button, choose, element } from "./viewer";

type Group = "boundaries" | "landmarks";

/** A point to take hold of; `at` says which point of the curve it began from it is, where nobody moved it. */
interface Handle {
  point: Vector;
  at: number | null;
}

/** What is drawn by one name: the curve it began from, and where its handles are now. */
interface Sketch {
  of: string | null;
  handles: Handle[];
}

type Drawn = Record<Group, Record<string, Sketch>>;

interface Stored {
  base: string | null;
  how: string | null;
}

interface StoredBoundary extends Stored {
  of?: string;
  curve?: Vector[];
  handles?: Handle[];
  confirmed?: { by: string; at: string; holds: boolean } | null;
}

interface StoredPlace extends Stored {
  points: Vector[];
}

/** What stands in the session. */
interface State {
  breasts: string[];
  landmarks: { name: string; title: string; kind: "point" | "line" }[];
  boundaries: Record<string, StoredBoundary>;
  places: Record<string, StoredPlace>;
  remark: string;
}

interface Drawing extends State {
  scene: PackedScene;
  author: string;
  /** The server knows who draws: the page does not ask. */
  signed: boolean;
}

interface LiveVolume {
  curve: Vector[];
  volumeCc: number | null;
  intervalCc: [number, number] | null;
  problem: string | null;
}

interface Thing {
  group: Group;
  name: string;
  title: string;
  kind: "closed" | "line" | "point";
}

const GRAB_PX = 12;
const CLICK_PX = 4;
const PAUSE_MS = 120;
const NAME_DAYS = 365;
const TITLES: Record<string, string> = { model: "boundary", left: "left boundary", right: "right boundary" };

class Editor {
  private readonly stage: Stage;
  private readonly worldFromView: Matrix4;
  private readonly viewFromWorld: Matrix4;
  private readonly things: Thing[];
  private readonly select: HTMLSelectElement;
  private readonly buttons: Record<"undo" | "redo" | "remove" | "clear" | "save" | "confirm", HTMLButtonElement>;
  private readonly author: HTMLInputElement;
  private readonly origin: HTMLElement;
  private readonly late: HTMLElement;
  private readonly volumes: HTMLElement;
  private readonly readout: HTMLElement;
  /** What to do after saving or confirming. */
  private readonly next: string;
  private drawn: Drawn;
  private past: Drawn[] = [];
  private future: Drawn[] = [];
  /** What of it stands in the session, and the version of each item that this was. */
  private saved: Drawn;
  private state: State;
  private curves: Record<string, Vector[]> = {};
  private chosen: number | null = null;
  private timer = 0;
  private asked = 0;

  private constructor(root: HTMLElement, drawing: Drawing, stage: (holder: HTMLElement) => Stage) {
    this.worldFromView = new Matrix4().fromArray(drawing.scene.worldFromView).transpose();
    this.viewFromWorld = this.worldFromView.clone().invert();
    this.state = drawing;
    this.drawn = this.saved = { boundaries: {}, landmarks: {} };
    this.next = drawing.signed
      ? "When all is drawn: Measure with these boundaries."
      : "Now run: mammometry run SESSION";
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
      save: button(bar, "Save", "Save what was changed into the session (Ctrl+S)", () => void this.save()),
      confirm: button(bar, "Confirm by eye", "Say that you looked at this boundary and found it right", () => {
        void this.confirm();
      }),
    };
    const label = element(bar, "label", "");
    element(label, "span", "").textContent = "Your name";
    this.author = element(label, "input", "");
    this.author.autocomplete = "name";
    this.author.maxLength = 80;
    this.author.value = drawing.author || rememberedName();
    this.author.onchange = () => rememberName(this.author.value);
    if (drawing.signed) {
      this.author.value = drawing.author;
      label.hidden = true;
    }
    this.buttons.save.classList.add("mm-save");
    this.origin = element(root, "p", "mm-origin");
    this.late = element(root, "div", "mm-late mm-bar-row");
    this.volumes = element(root, "div", "mm-volumes");
    const views = element(root, "div", "mm-bar-row");
    for (const name of Object.keys(DIRECTIONS))
      button(views, directionTitle(name, drawing.scene.ofPatient), "Look from there", () => this.stage.face(name));
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
    this.say(drawing.remark);
    for (const thing of this.things) this.take(thing, drawing);
    this.show();
    void this.measure();
  }

  static async create(root: HTMLElement): Promise<Editor> {
    const drawing = (await asked("drawing")) as Drawing;
    const model = await unpackModel(drawing.scene.models[0]!);
    return new Editor(root, drawing, (holder) => new Stage(holder, model));
  }

  private get handles(): Handle[] {
    return this.drawn[this.thing.group][this.thing.name]?.handles ?? [];
  }

  private get thing(): Thing {
    return this.things[Number(this.select.value)]!;
  }

  /** Take a step: what was there before can be had back. */
  private change(handles: Handle[]): void {
    this.past.push(this.drawn);
    this.future.length = 0;
    this.replace(handles);
  }

  /** Show other points without a step, as while a point is dragged. */
  private replace(handles: Handle[]): void {
    const { group, name } = this.thing;
    const of = this.drawn[group][name]?.of ?? null;
    this.drawn = withItem(this.drawn, this.thing, handles.length === 0 ? undefined : { of, handles });
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
    this.change(this.handles.filter((_, k) => k !== chosen));
  }

  private clear(): void {
    this.chosen = null;
    if (this.handles.length > 0) this.change([]);
  }

  private changed(): void {
    this.show();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.measure(), PAUSE_MS);
  }

  private show(): void {
    const view = (places: Vector[]) => places.map((point) => this.seen(point));
    const { group, name } = this.thing;
    const lines = Object.entries(this.drawn.boundaries).map(([breast, { handles }]) => ({
      points: view(this.curves[breast] ?? points(handles)),
      closed: handles.length > 2,
      bold: group === "boundaries" && breast === name,
    }));
    const marks: Vector[] = [];
    for (const [mark, { handles }] of Object.entries(this.drawn.landmarks)) {
      if (handles.length > 1) lines.push({ points: view(points(handles)), closed: false, bold: mark === name });
      else if (mark !== name) marks.push(...view(points(handles)));
    }
    this.stage.drawLines(lines);
    this.stage.drawHandles(view(points(this.handles)), this.chosen, marks);
    this.buttons.undo.disabled = this.past.length === 0;
    this.buttons.redo.disabled = this.future.length === 0;
    this.buttons.remove.disabled = this.chosen === null;
    this.buttons.clear.disabled = this.handles.length === 0;
    this.buttons.save.dataset.dirty = String(this.dirty.length > 0);
    this.buttons.confirm.disabled =
      group !== "boundaries" || this.isDirty(this.thing) || this.state.boundaries[name]?.of === undefined;
    this.origin.textContent = this.originWords(this.thing);
  }

  private originWords(thing: Thing): string {
    if (this.isDirty(thing)) return `${thing.title}: changed, not saved`;
    if (thing.group === "landmarks") {
      const { how } = this.state.places[thing.name]!;
      return how === null ? "" : `${thing.title}: ${how}`;
    }
    const { how, confirmed } = this.state.boundaries[thing.name]!;
    const words = `${thing.title}: ${how ?? "given"}`;
    if (!confirmed) return `${words}; not confirmed by eye`;
    const who = `confirmed by eye by ${confirmed.by} on ${confirmed.at.slice(0, 10)}`;
    return confirmed.holds ? `${words}; ${who}` : `${words}; an earlier curve was ${who}, this one is another`;
  }

  private get dirty(): Thing[] {
    return this.things.filter((thing) => this.isDirty(thing));
  }

  private isDirty({ group, name }: Thing): boolean {
    return JSON.stringify(this.drawn[group][name]) !== JSON.stringify(this.saved[group][name]);
  }

  /** Show an item as it stands in the session, in every step that may be had back too. */
  private take(thing: Thing, from: State): void {
    const { group, name } = thing;
    let sketch: Sketch | undefined;
    if (group === "boundaries") {
      const stored = from.boundaries[name]!;
      this.state.boundaries[name] = stored;
      delete this.curves[name];
      if (stored.curve !== undefined) {
        this.curves[name] = stored.curve;
        sketch = { of: stored.of!, handles: stored.handles! };
      }
    } else {
      const stored = from.places[name]!;
      this.state.places[name] = stored;
      if (stored.points.length > 0) sketch = { of: null, handles: stored.points.map((point) => ({ point, at: null })) };
    }
    this.saved = withItem(this.saved, thing, sketch);
    this.drawn = withItem(this.drawn, thing, sketch);
    this.past = this.past.map((step) => withItem(step, thing, sketch));
    this.future = this.future.map((step) => withItem(step, thing, sketch));
  }

  private stored({ group, name }: Thing, state: State): Stored {
    return group === "boundaries" ? state.boundaries[name]! : state.places[name]!;
  }

  /** Hear what stands in the session now. What was just sent is ours; what others changed is shown if it was left alone here. */
  private hear(state: State, sent: Drawn, ours: Thing[]): void {
    for (const thing of this.things) {
      const { group, name } = thing;
      if (ours.includes(thing)) {
        this.saved = withItem(this.saved, thing, sent[group][name]);
        if (group === "boundaries") this.state.boundaries[name] = state.boundaries[name]!;
        else this.state.places[name] = state.places[name]!;
      } else if (this.stored(thing, state).base !== this.stored(thing, this.state).base && !this.isDirty(thing))
        this.take(thing, state);
    }
    this.changed();
  }

  /** Ask what is enclosed; an answer that comes too late is left alone. */
  private async measure(): Promise<void> {
    const question = ++this.asked;
    const boundaries = Object.fromEntries(
      Object.entries(this.drawn.boundaries).filter(([, { handles }]) => handles.length > 2),
    );
    if (Object.keys(boundaries).length === 0) {
      this.curves = {};
      this.volumes.replaceChildren();
      this.show();
      return;
    }
    try {
      const found = (await asked("measure", { boundaries })) as Record<string, LiveVolume>;
      if (question !== this.asked) return;
      this.curves = Object.fromEntries(Object.entries(found).map(([name, live]) => [name, live.curve]));
      this.volumes.replaceChildren(...Object.entries(found).map(([name, live]) => volumeWords(name, live)));
      this.volumes.dataset.question = String(question);
      this.show();
    } catch (error) {
      this.say(`Not measured: ${words(error)}`);
    }
  }

  /** Send what was changed here, and nothing else. */
  private async save(): Promise<void> {
    const changed = this.dirty;
    if (changed.length === 0) return this.say("Nothing had changed.");
    const few = changed.find(
      ({ group, name }) => group === "boundaries" && (this.drawn[group][name]?.handles.length ?? 3) < 3,
    );
    if (few !== undefined) return this.say(`Not saved: the ${few.title} needs three points or more, or none.`);
    const author = this.named();
    if (author === null) return;
    const sent = this.drawn;
    const boundaries: Record<string, unknown> = {};
    const landmarks: Record<string, unknown> = {};
    for (const thing of changed) {
      const { group, name } = thing;
      const { base } = this.stored(thing, this.state);
      const sketch = sent[group][name];
      if (group === "boundaries") boundaries[name] = { base, sketch: sketch ?? null };
      else landmarks[name] = { base, points: sketch === undefined ? null : points(sketch.handles) };
    }
    this.late.replaceChildren();
    try {
      const answer = (await asked("save", { author, boundaries, landmarks })) as State & { saved: string[] };
      this.hear(answer, sent, changed);
      const kept = answer.saved.length === 0 ? "Saved already" : `Saved ${answer.saved.join(" and ")}; what was there before is in history/`;
      this.say(`${kept}. ${this.next}`);
    } catch (error) {
      this.say(`Not saved: ${words(error)}`);
      const late = error instanceof Refused ? (error.reply as { late?: [Group, string][] }).late : undefined;
      if (late !== undefined) this.offer(late);
    }
  }

  /** Somebody else was faster: nothing is lost whichever is chosen. */
  private offer(late: [Group, string][]): void {
    const things = this.things.filter(({ group, name }) => late.some((item) => item[0] === group && item[1] === name));
    const answer = async (act: (state: State) => void): Promise<void> => {
      try {
        act((await asked("items")) as State);
        this.late.replaceChildren();
      } catch (error) {
        this.say(`Not loaded: ${words(error)}`);
      }
    };
    button(this.late, "Load theirs", "Show what the other has saved; yours is kept in history/", () => {
      void answer((state) => {
        for (const thing of things) this.take(thing, state);
        this.chosen = null;
        this.changed();
        this.say("Theirs is shown. Yours is kept in history/.");
      });
    });
    button(this.late, "Replace it by mine", "Save yours; theirs is kept in history/", () => {
      void answer((state) => {
        for (const { group, name } of things) {
          if (group === "boundaries") this.state.boundaries[name] = state.boundaries[name]!;
          else this.state.places[name] = state.places[name]!;
        }
        void this.save();
      });
    });
  }

  private async confirm(): Promise<void> {
    const { thing } = this;
    const stored = this.state.boundaries[thing.name];
    const author = this.named();
    if (author === null || stored?.of === undefined) return;
    try {
      const sent = { author, name: thing.name, base: stored.base, curve: stored.of };
      this.hear((await asked("confirm", sent)) as State, this.drawn, [thing]);
      this.say(`The ${thing.title} is confirmed. ${this.next}`);
    } catch (error) {
      this.say(`Not confirmed: ${words(error)}`);
    }
  }

  private named(): string | null {
    const name = this.author.value.trim();
    if (name !== "") return name;
    this.say("Type your name first: it is kept beside what you draw and confirm.");
    this.author.focus();
    return null;
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
      const moved = { point: this.world(hit.point), at: null };
      this.replace(this.handles.map((handle, k) => (k === index ? moved : handle)));
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
      if (event.target instanceof HTMLInputElement && !(control && key === "s")) return;
      if (control && key === "z") this.buttons[event.shiftKey ? "redo" : "undo"].click();
      else if (control && key === "y") this.buttons.redo.click();
      else if (control && key === "s") void this.save();
      else if (key === "delete" || key === "backspace") this.remove();
      else return;
      event.preventDefault();
    });
    window.addEventListener("beforeunload", (event) => {
      if (this.dirty.length > 0) event.preventDefault();
    });
  }

  private add(clientX: number, clientY: number): void {
    const hit = this.stage.pick(clientX, clientY);
    if (hit === null) return;
    const handle = { point: this.world(hit.point), at: null };
    const { handles, thing } = this;
    if (thing.kind === "point") {
      this.chosen = 0;
      this.change([handle]);
      return;
    }
    const between = thing.kind === "closed" && handles.length > 2;
    const at = between ? cheapestPlace(points(handles), handle.point) : handles.length;
    this.chosen = at;
    this.change([...handles.slice(0, at), handle, ...handles.slice(at)]);
  }

  /** The handle under the pointer, on the side that is seen. */
  private handleAt(clientX: number, clientY: number): number | null {
    let best: number | null = null;
    let reach = GRAB_PX;
    this.handles.forEach(({ point }, k) => {
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

function points(handles: Handle[]): Vector[] {
  return handles.map(({ point }) => point);
}

function withItem(drawn: Drawn, { group, name }: Thing, sketch: Sketch | undefined): Drawn {
  const items = { ...drawn[group] };
  if (sketch === undefined) delete items[name];
  else items[name] = sketch;
  return { ...drawn, [group]: items };
}

const root = document.getElementById("mm-editor")!;

/** Ask the server. The page says where the session is answered. */
function asked(path: string, json?: object): Promise<unknown> {
  return request((root.dataset.at ?? "") + path, json === undefined ? {} : { json });
}

/** A cookie, since every start has another port, and storage is kept by port. */
function rememberName(name: string): void {
  const lasting = `max-age=${NAME_DAYS * 86400}; path=/; samesite=strict`;
  document.cookie = `mammometry-author=${encodeURIComponent(name.trim())}; ${lasting}`;
}

function rememberedName(): string {
  const found = /(?:^|; )mammometry-author=([^;]*)/.exec(document.cookie);
  return found === null ? "" : decodeURIComponent(found[1]!);
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

Editor.create(root).then(
  () => (root.dataset.ready = "1"),
  (error: unknown) => (root.textContent = `The surface cannot be shown: ${words(error)}`),
);
