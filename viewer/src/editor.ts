/** One page of boundaries: left, right and landmarks are looked at in steps, changed where needed, and confirmed. */

import { Matrix4, Vector3 } from "three";

import { Refused, request } from "./clinic/request";
import { Drawing, type Group, type Handle, type Item, type Job, type LiveVolume, type Page, type State, cheapestPlace, points } from "./editor/drawing";
import { rememberName, rememberedName } from "./editor/author";
import { fillWindow } from "./editor/layout";
import { followPointer } from "./editor/pointer";
import { volumeNote, volumeWords } from "./editor/volume_words";
import { type Vector, unpackModel } from "./format";
import { DIRECTIONS, directionTitle, Stage } from "./stage";
import { button, choose, element } from "./viewer";

/** A part of the page: one breast, or all landmarks. */
interface Step {
  title: string;
  help: string;
  /** The boundary; null: the landmarks. */
  breast: Item | null;
  from: Vector;
}

const GRAB_PX = 12;
const PAUSE_MS = 120;
const POLL_MS = 1500;
const FROM: Record<string, Vector> = { left: [0.5, 0.1, 0.85], right: [-0.5, 0.1, 0.85], model: [0, 0.3, 1] };
const AHEAD: Vector = [0, 0.05, 1];
const LOOK = "Does the line follow the edge of the breast? Turn the surface to see all of it.";
const DRAW = "Drag a point to move it. Click the surface to add one. Drag elsewhere to turn the surface.";
const MARK = "Choose a landmark, then click its place on the surface. None of them is required. Those with a question mark are proposals. Confirming accepts them as they are: if one is wrong, choose it and click its place.";

const root = document.getElementById("mm-editor")!;

class Editor {
  private readonly drawing: Drawing;
  private readonly stage: Stage;
  private readonly worldFromView: Matrix4;
  private readonly viewFromWorld: Matrix4;
  private readonly steps: Step[];
  private readonly stepButtons: HTMLButtonElement[];
  private readonly heading: HTMLElement;
  private readonly volume: HTMLElement;
  private readonly origin: HTMLElement;
  private readonly marks: HTMLElement;
  private readonly tools: HTMLElement;
  private readonly problem: HTMLElement;
  private readonly readout: HTMLElement;
  private readonly late: HTMLElement;
  private readonly author: HTMLInputElement;
  private readonly acts: Record<"edit" | "right" | "save" | "measure" | "finish", HTMLButtonElement>;
  private readonly buttons: Record<"undo" | "redo" | "remove" | "clear", HTMLButtonElement>;
  /** Breast → digest of the curve that was looked at and found right. */
  private readonly right = new Map<string, string>();
  private readonly signed: boolean;
  private live: Record<string, LiveVolume> = {};
  private at = 0;
  private mark: Item | null = null;
  private editing = false;
  private busy = false;
  private chosen: number | null = null;
  private timer = 0;
  private polling = 0;
  private question = 0;

  private constructor(page: Page, stage: (holder: HTMLElement) => Stage) {
    this.worldFromView = new Matrix4().fromArray(page.scene.worldFromView).transpose();
    this.viewFromWorld = this.worldFromView.clone().invert();
    this.drawing = new Drawing(page);
    this.signed = page.signed;
    const breasts = this.drawing.items.filter(({ group }) => group === "boundaries");
    this.steps = [
      ...breasts.map((item): Step => ({ title: item.title, help: LOOK, breast: item, from: FROM[item.name]! })),
      { title: "Landmarks", help: MARK, breast: null, from: AHEAD },
    ];
    this.mark = this.drawing.items.find(({ group }) => group === "landmarks") ?? null;

    root.replaceChildren();
    const work = element(root, "div", "mm-work");
    const list = element(work, "ol", "mm-steps");
    this.stepButtons = this.steps.map(({ title }, k) =>
      button(element(list, "li", ""), title, "", () => this.go(k)),
    );
    const about = element(work, "div", "mm-about");
    this.heading = element(about, "h2", "");
    this.volume = element(about, "p", "mm-volume");
    this.origin = element(about, "p", "mm-origin");
    // What changes its length stands beside or under the picture, which stays where it is.
    const picture = element(work, "div", "mm-canvas");
    this.problem = element(picture, "p", "mm-problem");
    this.problem.setAttribute("role", "alert");
    // What a button caused is said beside it.
    const bar = element(work, "div", "mm-do");
    const acts = element(bar, "div", "mm-acts mm-bar-row");
    const label = element(acts, "label", "");
    element(label, "span", "").textContent = "Your name";
    this.author = element(label, "input", "");
    this.author.autocomplete = "name";
    this.author.maxLength = 80;
    this.author.value = page.author || rememberedName();
    this.author.onchange = () => rememberName(this.author.value);
    label.hidden = page.signed;
    this.acts = {
      edit: button(acts, "Change the line", "Show the line's points and change them", () => this.edit(!this.editing)),
      save: button(acts, "Save", "Save the changes (Ctrl+S)", () => void this.save()),
      measure: button(acts, "Measure", "Measure with the saved changes", () => void this.measure()),
      right: button(acts, "Looks right", "Go on to the next step", () => this.approve()),
      finish: button(acts, "Confirm and finish", "Record that you checked every line and that they are right", () => void this.finish()),
    };
    this.readout = element(bar, "p", "mm-readout");
    this.readout.setAttribute("role", "status");
    this.late = element(bar, "div", "mm-bar-row");
    this.marks = element(work, "div", "mm-marks mm-bar-row");
    this.tools = element(work, "div", "mm-tools mm-bar-row");
    this.buttons = {
      undo: button(this.tools, "Undo", "Undo (Ctrl+Z)", () => this.step(() => this.drawing.undo())),
      redo: button(this.tools, "Redo", "Redo (Ctrl+Shift+Z)", () => this.step(() => this.drawing.redo())),
      remove: button(this.tools, "Remove point", "Remove the chosen point (Delete)", () => this.remove()),
      clear: button(this.tools, "Start anew", "Remove all points and draw from the beginning", () => this.clear()),
    };
    fillWindow(picture);
    this.stage = stage(picture);
    const views = element(work, "div", "mm-views mm-bar-row");
    for (const name of Object.keys(DIRECTIONS))
      button(views, directionTitle(name, page.scene.ofPatient), "Look from there", () => this.stage.face(name));
    const looks = choose(views, "Colour", [
      ["photograph", "photograph"],
      ["shaded", "shaded"],
      ["provenance", "where it comes from"],
    ]);
    looks.onchange = () => void this.stage.look(looks.value);
    void this.stage.look("photograph");
    this.listen();
    this.go(0);
    if (page.remark !== "") this.say(page.remark);
    void this.estimate();
    this.poll();
  }

  static async create(): Promise<Editor> {
    const page = await ask<Page>("drawing");
    const model = await unpackModel({ ...page.scene.models[0]!, curves: [], landmarks: [], lengths: [] });
    return new Editor(page, (holder) => new Stage(holder, model));
  }

  // --- steps ---

  private get place(): Step {
    return this.steps[this.at]!;
  }

  /** What is drawn on now. */
  private get item(): Item | null {
    return this.place.breast ?? this.mark;
  }

  private go(to: number): void {
    this.at = to;
    this.editing = false;
    this.chosen = null;
    this.show3d();
    this.say("");
    this.show();
  }

  /** Bring the picture into the window, and this step's line into the picture. */
  private show3d(): void {
    const curve = this.place.breast === null ? [] : this.curve(this.place.breast.name);
    if (curve.length > 2) this.stage.approach(curve.map((point) => this.seen(point)), this.place.from);
    else this.stage.face("front");
    if (!this.stage.isInWindow([])) this.stage.canvas.parentElement!.scrollIntoView({ block: "nearest" });
  }

  private edit(on: boolean): void {
    this.editing = on;
    this.chosen = null;
    this.say("");
    this.show();
  }

  /** The line of this step was looked at. One that is not wholly in view is shown first. */
  private approve(): void {
    const { breast } = this.place;
    const curve = breast === null ? [] : this.curve(breast.name).map((point) => this.seen(point));
    if (!this.stage.isInWindow(curve)) {
      this.show3d();
      this.say("It was not completely in view. Check it now, then press “Looks right” again.");
      return;
    }
    if (breast !== null) this.right.set(breast.name, this.stored(breast.name).of ?? "");
    this.go(Math.min(this.at + 1, this.steps.length - 1));
  }

  private isRight(breast: string): boolean {
    return this.right.get(breast) === (this.stored(breast).of ?? "");
  }

  /** What still has to be done before all can be confirmed, in a sentence; empty: nothing. */
  private get missing(): string {
    const { state, changed } = this.drawing;
    if (changed.length > 0) return `Save first: ${changed.map(({ title }) => title.toLowerCase()).join(", ")}.`;
    const unseen = this.steps.filter(({ breast }) => breast !== null && !this.isRight(breast.name));
    if (unseen.length > 0) return `Look at this first: ${unseen.map(({ title }) => title.toLowerCase()).join(", ")}.`;
    if (this.isMeasuring) return "Your changes are being measured. You can confirm afterwards.";
    const open = state.breasts.filter((name) => !this.isMeasured(name));
    if (open.length > 0) return "Your changes must be measured first.";
    return state.breasts.every((name) => this.stored(name).of === undefined) ? "There is no line to confirm." : "";
  }

  /** The visit's job that has not ended. */
  private get openJob(): Job | null {
    const job = this.drawing.state.job;
    return job != null && ["queued", "running"].includes(job.state) ? job : null;
  }

  private get isMeasuring(): boolean {
    return this.openJob !== null;
  }

  private stored(breast: string): State["boundaries"][string] {
    return this.drawing.state.boundaries[breast]!;
  }

  private isMeasured(breast: string): boolean {
    const { of, measured } = this.stored(breast);
    return measured?.of === of;
  }

  private curve(breast: string): Vector[] {
    const item = this.drawing.items.find(({ group, name }) => group === "boundaries" && name === breast)!;
    if (this.drawing.isChanged(item)) return this.live[breast]?.curve ?? points(this.drawing.handles(item));
    return this.stored(breast).curve ?? [];
  }

  // --- changes ---

  private step(act: () => void): void {
    act();
    this.chosen = null;
    this.changed();
  }

  private change(handles: Handle[]): void {
    if (this.item !== null) this.drawing.change(this.item, handles);
    this.changed();
  }

  private remove(): void {
    const { chosen, item } = this;
    if (chosen === null || item === null) return;
    this.chosen = null;
    this.change(this.drawing.handles(item).filter((_, k) => k !== chosen));
  }

  private clear(): void {
    this.chosen = null;
    if (this.item !== null && this.drawing.handles(this.item).length > 0) this.change([]);
  }

  private changed(): void {
    this.show();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.estimate(), PAUSE_MS);
  }

  // --- what is shown ---

  private show(): void {
    const { drawing, item } = this;
    const { breast } = this.place;
    const view = (places: Vector[]) => places.map((point) => this.seen(point));
    const lines = drawing.state.breasts.map((name) => {
      const curve = this.curve(name);
      return { points: view(curve), closed: curve.length > 2, bold: breast?.name === name };
    });
    const others: Vector[] = [];
    for (const mark of drawing.items.filter(({ group }) => group === "landmarks")) {
      const handles = drawing.handles(mark);
      const proposed = breast === null ? drawing.proposed(mark) : [];
      if (proposed.length > 1) lines.push({ points: view(proposed), closed: false, bold: false });
      else others.push(...view(proposed));
      if (handles.length > 1) lines.push({ points: view(points(handles)), closed: false, bold: mark === item });
      else if (mark !== item) others.push(...view(points(handles)));
    }
    const active = item !== null && (this.editing || breast === null);
    this.stage.drawLines(lines);
    this.stage.drawHandles(active ? view(points(drawing.handles(item))) : [], this.chosen, others, view(this.crossings));
    this.showHead();
    this.showActs(active);
    this.stepButtons.forEach((own, k) => {
      const { title, breast: of } = this.steps[k]!;
      const done = of !== null && !drawing.isChanged(of) && this.isRight(of.name);
      own.textContent = `${done ? "✓" : k + 1} ${title}`;
      if (k === this.at) own.setAttribute("aria-current", "step");
      else own.removeAttribute("aria-current");
    });
  }

  private get crossings(): Vector[] {
    const { breast } = this.place;
    return breast !== null && this.drawing.isChanged(breast) ? (this.live[breast.name]?.crossings ?? []) : [];
  }

  private showHead(): void {
    const { breast, title } = this.place;
    const { drawing } = this;
    this.heading.textContent = title;
    this.volume.hidden = this.origin.hidden = breast === null;
    this.marks.hidden = breast !== null;
    let problem = "";
    if (breast === null) this.showMarks();
    else {
      const { measured, how, of } = this.stored(breast.name);
      const untouched = !drawing.isChanged(breast) && this.isMeasured(breast.name);
      const volume = untouched ? measured : this.live[breast.name];
      this.volume.replaceChildren(...(volume === undefined ? [] : volumeWords(volume, this.signed)));
      const note = volumeNote(volume, of !== undefined || drawing.isChanged(breast), this.openJob);
      const line = drawing.isChanged(breast) ? "Changed, not saved." : of === undefined ? "No line was found here." : `Line: ${how === "automatic" ? "found automatically" : (how ?? "given")}.`;
      this.origin.replaceChildren(note, line);
      if (this.crossings.length > 0) problem = "The line crosses itself at the red mark. Move or remove a point there. It cannot be saved like this.";
      else if (!untouched && volume?.problem) problem = volume.problem;
    }
    if (this.problem.textContent !== problem) this.problem.textContent = problem;
    this.problem.hidden = problem === "";
  }

  private showMarks(): void {
    const marks = this.drawing.items.filter(({ group }) => group === "landmarks");
    if (this.marks.childElementCount === 0)
      for (const mark of marks)
        button(this.marks, mark.title, "Choose it, then click its place", () => {
          this.mark = mark;
          this.chosen = null;
          this.show();
        });
    marks.forEach((mark, k) => {
      const own = this.marks.children[k]!;
      const sign = this.drawing.handles(mark).length > 0 ? "✓ " : this.drawing.proposed(mark).length > 0 ? "? " : "";
      own.textContent = `${sign}${mark.title}`;
      own.setAttribute("aria-pressed", String(mark === this.mark));
    });
  }

  private showActs(active: boolean): void {
    const { drawing, acts, buttons } = this;
    const last = this.at === this.steps.length - 1;
    const { breast } = this.place;
    const dirty = drawing.changed.length > 0;
    const unmeasured = drawing.state.breasts.some((name) => !this.isMeasured(name));
    acts.edit.hidden = breast === null;
    acts.edit.textContent = breast !== null && drawing.handles(breast).length === 0 ? "Draw the line" : "Change the line";
    acts.edit.setAttribute("aria-pressed", String(this.editing));
    acts.save.hidden = !dirty;
    acts.save.disabled = this.busy || this.crossings.length > 0;
    acts.measure.hidden = this.signed || dirty || !unmeasured;
    acts.measure.disabled = this.busy;
    acts.right.hidden = breast === null || drawing.isChanged(breast);
    acts.finish.hidden = !last;
    acts.finish.disabled = this.busy || this.missing !== "";
    for (const [own, main] of [[acts.save, dirty], [acts.right, !dirty], [acts.finish, true]] as const) own.classList.toggle("mm-main", main);
    this.tools.hidden = !active && !drawing.canUndo && !drawing.canRedo;
    buttons.undo.disabled = !drawing.canUndo || this.busy;
    buttons.redo.disabled = !drawing.canRedo || this.busy;
    buttons.remove.disabled = this.chosen === null || this.busy;
    buttons.clear.disabled = !active || this.item === null || drawing.handles(this.item).length === 0 || this.busy;
    if (!this.spoken) this.readout.textContent = this.hint;
  }

  /** What is to be done here. */
  private get hint(): string {
    if (this.place.breast === null) return this.missing || `${MARK} Then confirm.`;
    return this.editing ? DRAW : this.place.help;
  }

  private spoken = false;

  private say(text: string): void {
    this.spoken = text !== "";
    this.readout.textContent = text || this.hint;
  }

  // --- the server ---

  /** Ask what is enclosed; an answer that comes too late is left alone. */
  private async estimate(): Promise<void> {
    const question = ++this.question;
    const { state, items } = this.drawing;
    const drawn = items.filter((item) => item.group === "boundaries" && this.drawing.handles(item).length > 2);
    if (drawn.every((item) => !this.drawing.isChanged(item) && this.isMeasured(item.name))) {
      this.live = {};
      return this.show();
    }
    const boundaries = Object.fromEntries(drawn.map((item) => [item.name, this.drawing.sketch(item)]));
    try {
      const live = await ask<Record<string, LiveVolume>>("measure", { boundaries });
      if (question !== this.question || state !== this.drawing.state) return;
      this.live = live;
      root.dataset.question = String(question);
      this.show();
    } catch (error) {
      this.say(`Not measured: ${words(error)}`);
    }
  }

  /** Run a request that changes something; meanwhile nothing else is changed. What fails leaves the drawing as it is. */
  private async act(failure: string, request: () => Promise<void>): Promise<void> {
    this.busy = true;
    this.show();
    try {
      await request();
    } catch (error) {
      this.say(`${failure}: ${words(error)}`);
      const late = error instanceof Refused ? (error.reply as { late?: [Group, string][] }).late : undefined;
      if (late !== undefined) this.offer(late);
    }
    this.busy = false;
    this.show();
    this.poll();
  }

  /** Send what was changed here, and nothing else. */
  private async save(): Promise<void> {
    const { changed } = this.drawing;
    if (changed.length === 0) return this.say("Nothing had changed.");
    const few = changed.find((item) => item.group === "boundaries" && [1, 2].includes(this.drawing.handles(item).length));
    if (few !== undefined) return this.say(`Not saved: ${few.title.toLowerCase()} needs three points or more, or none.`);
    const author = this.named();
    if (author === null) return;
    this.late.replaceChildren();
    await this.act("Not saved", async () => {
      this.hear(await ask<State>("save", { author, ...this.drawing.body(changed) }), changed);
      this.edit(false);
      const waits = !this.signed && this.drawing.state.breasts.some((name) => !this.isMeasured(name));
      this.say(this.isMeasuring ? "Saved. It is being measured." : waits ? "Saved. Press “Measure”." : "Saved.");
    });
  }

  /** Measure on this computer, where no clinic does. */
  private async measure(): Promise<void> {
    this.say("Measuring. This takes a minute or more.");
    await this.act("Not measured", async () => {
      this.hear(await ask<State>("run", {}));
      this.say("Measured. Check the lines again.");
    });
  }

  private async finish(): Promise<void> {
    const { state } = this.drawing;
    const author = this.named();
    if (author === null) return;
    const curves = Object.fromEntries(
      state.breasts.flatMap((name) => (this.stored(name).of === undefined ? [] : [[name, this.stored(name).of]])),
    );
    await this.act("Not confirmed", async () => {
      const reply = await ask<State & { next?: string }>("finish", this.signed ? { curves, base: this.drawing.bases } : { author, curves });
      if (reply.next !== undefined) return window.location.assign(reply.next);
      this.hear(reply);
      this.say("Confirmed. You may close this page.");
    });
  }

  private hear(state: State, sent: Item[] = []): void {
    this.drawing.hear({ ...this.drawing.state, ...state }, sent);
    this.changed();
  }

  /** Look until the visit's job has ended. */
  private poll(): void {
    clearTimeout(this.polling);
    if (!this.isMeasuring) return;
    this.polling = setTimeout(() => {
      void ask<State>("items").then(
        (state) => {
          this.hear(state);
          const job = state.job;
          if (!this.isMeasuring && job != null)
            this.say(job.state === "done" ? "Measured. Check the new volumes, then confirm." : `It could not be measured. ${job.message}`);
          this.poll();
        },
        () => this.poll(),
      );
    }, POLL_MS);
  }

  /** Somebody else was faster: nothing is lost whichever is chosen. */
  private offer(late: [Group, string][]): void {
    const items = this.drawing.items.filter(({ group, name }) => late.some((item) => item[0] === group && item[1] === name));
    const answer = async (act: (state: State) => void): Promise<void> => {
      try {
        act(await ask<State>("items"));
        this.late.replaceChildren();
      } catch (error) {
        this.say(`Not loaded: ${words(error)}`);
      }
    };
    button(this.late, "Load theirs", "Show the other version; yours is kept", () => {
      void answer((state) => {
        this.hear(state, items);
        this.say("Theirs is shown now.");
      });
    });
    button(this.late, "Replace it by mine", "Save yours instead; theirs is kept", () => {
      void answer((state) => {
        for (const item of items) this.drawing.stored(item).base = this.drawing.stored(item, state).base;
        void this.save();
      });
    });
  }

  private named(): string | null {
    const name = this.author.value.trim();
    if (name !== "") return name;
    this.say("First enter your name: it is stored with your drawings and confirmations.");
    this.author.focus();
    return null;
  }

  // --- mouse and keys ---

  private listen(): void {
    let before = this.drawing.now;
    followPointer(this.stage, {
      canDraw: () => !this.busy && this.item !== null && (this.editing || this.place.breast === null),
      handleAt: (x, y) => this.handleAt(x, y),
      grabbed: (index) => {
        before = this.drawing.now;
        this.chosen = index;
        this.show();
      },
      dragged: (index, to) => {
        const moved = { point: this.world(to), at: null };
        const handles = this.drawing.handles(this.item!).map((handle, k) => (k === index ? moved : handle));
        this.drawing.replace(this.item!, handles);
        this.changed();
      },
      dropped: () => {
        this.drawing.step(before);
        this.show();
      },
      clicked: (at) => this.add(at),
    });
    document.addEventListener("keydown", (event) => {
      const control = event.ctrlKey || event.metaKey;
      const key = event.key.toLowerCase();
      if (event.target instanceof HTMLInputElement && !(control && key === "s")) return;
      if (control && key === "z") this.buttons[event.shiftKey ? "redo" : "undo"].click();
      else if (control && key === "y") this.buttons.redo.click();
      else if (control && key === "s") void this.save();
      else if (key === "delete" || key === "backspace") this.buttons.remove.click();
      else return;
      event.preventDefault();
    });
    window.addEventListener("beforeunload", (event) => {
      if (this.drawing.changed.length > 0) event.preventDefault();
    });
  }

  private add(place: Vector3): void {
    const { item } = this;
    if (item === null) return;
    const handle = { point: this.world(place), at: null };
    const handles = this.drawing.handles(item);
    if (item.kind === "point") {
      this.chosen = 0;
      return this.change([handle]);
    }
    const between = item.kind === "closed" && handles.length > 2;
    const at = between ? cheapestPlace(points(handles), handle.point) : handles.length;
    this.chosen = at;
    this.change([...handles.slice(0, at), handle, ...handles.slice(at)]);
  }

  /** The handle under the pointer, on the side that is seen. */
  private handleAt(clientX: number, clientY: number): number | null {
    if (this.item === null) return null;
    let best: number | null = null;
    let reach = GRAB_PX;
    this.drawing.handles(this.item).forEach(({ point }, k) => {
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
}

/** Ask the server. The page says where the session is answered. */
function ask<T>(path: string, json?: object): Promise<T> {
  return request<T>((root.dataset.at ?? "") + path, json === undefined ? {} : { json });
}

function words(error: unknown): string {
  if (error instanceof TypeError) return "the server cannot be reached. Try again in a moment.";
  return error instanceof Error ? error.message : String(error);
}

Editor.create().then(
  () => (root.dataset.ready = "1"),
  (error: unknown) => (root.textContent = `The surface cannot be shown: ${words(error)}`),
);
