/** The panel around the pictures: one model, or two side by side that turn together. */

import { Box3 } from "three";

import { legend, number, valueWords } from "./colours";
import { type Model, type PackedScene, unpackModel } from "./format";
import { DIRECTIONS, directionTitle, type Hit, Stage } from "./stage";

const AXES = ["whole", "across", "height", "depth"] as const;
const TURN_RAD = Math.PI / 24;

interface Choice {
  title: string;
  models: string[];
}

export class Viewer {
  readonly stages: Stage[] = [];
  private readonly models = new Map<string, Model>();
  private readonly choices: Choice[];
  private readonly pictures: HTMLElement;
  private readonly legendBox: HTMLElement;
  private readonly readout: HTMLElement;
  private readonly controls: Record<"model" | "look" | "section", HTMLSelectElement>;
  /** Buttons in place of the choice of colours, where the page asks for them. */
  private readonly lookButtons: HTMLElement | null;
  private readonly captions: string[];
  private readonly slider: HTMLInputElement;
  private readonly toggles: Record<"boundary" | "lengths" | "wall" | "measure", HTMLButtonElement>;
  private picked: { stage: Stage; hits: Hit[] } | null = null;

  private constructor(
    root: HTMLElement,
    private readonly packed: PackedScene,
  ) {
    this.choices = [
      ...packed.models.map((model) => ({ title: model.title, models: [model.name] })),
      ...packed.comparisons.map(({ title, first, second }) => ({ title, models: [first, second] })),
    ];
    const bar = element(root, "div", "mm-bar-row");
    this.controls = {
      model: choose(bar, "Show", this.choices.map((choice, k) => [String(k), choice.title])),
      look: choose(bar, "Colour", []),
      section: choose(bar, "Section", AXES.map((axis) => [axis, axis])),
    };
    this.controls.model.parentElement!.hidden = this.choices.length < 2;
    this.captions = root.dataset.captions?.split("|") ?? [];
    this.lookButtons = root.dataset.buttons === undefined ? null : element(bar, "span", "mm-looks");
    if (this.lookButtons !== null) {
      this.lookButtons.dataset.looks = root.dataset.buttons;
      this.lookButtons.setAttribute("role", "group");
      this.lookButtons.setAttribute("aria-label", "Colour");
      this.controls.look.parentElement!.hidden = true;
    }
    this.slider = bar.appendChild(document.createElement("input"));
    Object.assign(this.slider, { type: "range", min: "0", max: "1", step: "0.002", value: "0.5", hidden: true });
    this.slider.setAttribute("aria-label", "Position of the section");
    const views = element(root, "div", "mm-bar-row");
    Object.keys(DIRECTIONS).forEach((name, k) =>
      button(views, directionTitle(name, packed.ofPatient), `Look from there (key ${k + 1})`, () => this.each((stage) => stage.face(name))),
    );
    const wall = packed.ofPatient ? "Chest wall" : "Back";
    this.toggles = {
      boundary: toggle(views, "Boundary", "Show boundary and landmarks (key B)", true, () => this.apply()),
      lengths: toggle(views, "Lengths", "Show the measured lengths (key L)", true, () => this.apply()),
      wall: toggle(views, wall, `Show the ${wall.toLowerCase()} (key W)`, false, () => this.apply()),
      measure: toggle(views, "Measure", "Measure between two points (key M)", false, () => this.forget()),
    };
    button(views, "Screenshot", "Save the picture as PNG (key S)", () => void this.save());
    this.pictures = element(root, "div", "mm-pictures");
    this.legendBox = element(root, "div", "mm-legend-row");
    this.readout = element(root, "p", "mm-readout");
    this.readout.setAttribute("role", "status");
    this.say("");

    this.controls.model.onchange = () => void this.show();
    this.controls.look.onchange = () => void this.colour();
    this.controls.section.onchange = this.slider.oninput = () => this.apply();
    root.addEventListener("keydown", (event) => this.key(event));
  }

  static async create(root: HTMLElement, packed: PackedScene): Promise<Viewer> {
    const { show, look } = root.dataset;
    const viewer = new Viewer(root, packed);
    if (show !== undefined) viewer.controls.model.value = show;
    await viewer.show();
    if (look !== undefined && viewer.offers(look)) {
      viewer.controls.look.value = look;
      await viewer.colour();
    }
    return viewer;
  }

  /** Build the chosen pictures anew. */
  private async show(): Promise<void> {
    const choice = this.choices[Number(this.controls.model.value)]!;
    const models = await Promise.all(choice.models.map((name) => this.model(name)));
    this.picked = null;
    this.pictures.replaceChildren();
    for (const stage of this.stages.splice(0)) stage.dispose();
    for (const [k, model] of models.entries()) {
      const figure = element(this.pictures, "figure", "mm-picture");
      const holder = element(figure, "div", "mm-canvas");
      if (models.length > 1) element(figure, "figcaption", "").textContent = this.captions[k] ?? model.title;
      const stage = new Stage(holder, model);
      stage.canvas.addEventListener("click", (event) => this.click(stage, event));
      this.stages.push(stage);
    }
    for (const stage of this.stages)
      stage.onMoved = () => this.each((other) => other !== stage && other.follow(stage));
    const both = this.stages.reduce((box, stage) => box.union(stage.extent), new Box3());
    if (this.stages.length > 1) this.each((stage) => stage.frame(both));
    this.toggles.wall.disabled = models.every((model) => model.wall === null);
    this.toggles.boundary.disabled = models.every((model) => model.curves.length + model.landmarks.length === 0);
    this.toggles.lengths.hidden = models.every((model) => model.lengths.length === 0);
    this.offerLooks(models);
    await this.colour();
    this.apply();
  }

  private async model(name: string): Promise<Model> {
    let model = this.models.get(name);
    if (model === undefined) {
      model = await unpackModel(this.packed.models.find((packed) => packed.name === name)!);
      this.models.set(name, model);
    }
    return model;
  }

  private offerLooks(models: Model[]): void {
    const wanted = this.controls.look.value;
    const looks: [string, string][] = [];
    if (models.some((model) => model.texture !== null || model.colours !== null)) looks.push(["photograph", "photograph"]);
    looks.push(["shaded", "shaded"]);
    for (const layer of models.flatMap((model) => model.layers))
      if (!looks.some(([name]) => name === layer.name)) looks.push([layer.name, layer.title]);
    this.controls.look.replaceChildren(...looks.map(([name, title]) => new Option(title, name)));
    if (looks.some(([name]) => name === wanted)) this.controls.look.value = wanted;
    const choose = (name: string): void => {
      this.controls.look.value = name;
      void this.colour();
    };
    this.lookButtons?.replaceChildren();
    for (const wished of this.lookButtons?.dataset.looks?.split(" ") ?? []) {
      const title = looks.find(([name]) => name === wished)?.[1];
      if (title === undefined) continue;
      const made = button(this.lookButtons!, capital(title), `Colour: ${title}`, () => choose(wished));
      made.dataset.look = wished;
    }
  }

  private offers(look: string): boolean {
    return [...this.controls.look.options].some((option) => option.value === look);
  }

  private async colour(): Promise<void> {
    const look = this.controls.look.value;
    for (const each of this.lookButtons?.children ?? [])
      each.setAttribute("aria-pressed", String((each as HTMLElement).dataset.look === look));
    await Promise.all(this.stages.map((stage) => stage.look(look)));
    const layer = this.stages.map((stage) => stage.layer(look)).find((found) => found !== undefined);
    this.legendBox.replaceChildren();
    if (layer !== undefined) {
      this.legendBox.append(legend(layer));
      element(this.legendBox, "p", "mm-help").textContent = layer.help;
    }
  }

  /** Bring all pictures to what the panel says. */
  private apply(): void {
    const axis = AXES.indexOf(this.controls.section.value as (typeof AXES)[number]) - 1;
    this.slider.hidden = axis < 0;
    const section = { axis: axis < 0 ? null : axis, share: Number(this.slider.value) };
    this.each((stage) => {
      stage.showBoundary(pressed(this.toggles.boundary));
      stage.showLengths(pressed(this.toggles.lengths));
      stage.showWall(pressed(this.toggles.wall));
      const at = stage.cut(section);
      if (axis >= 0) this.say(`Section at ${number(at)} mm (${this.controls.section.value}).`);
    });
  }

  private click(stage: Stage, event: MouseEvent): void {
    const hit = stage.pick(event.clientX, event.clientY);
    if (hit === null) return;
    if (pressed(this.toggles.measure)) this.measure(stage, hit);
    else {
      const layer = stage.layer(this.controls.look.value);
      stage.mark([hit.point], false);
      const place = hit.point.toArray().map(number).join(", ");
      this.say(layer === undefined ? `Point at (${place}) mm.` : `${layer.title}: ${valueWords(layer, hit.vertex)}.`);
    }
  }

  private measure(stage: Stage, hit: Hit): void {
    if (this.picked === null || this.picked.stage !== stage || this.picked.hits.length > 1) {
      this.each((other) => other.mark([], false));
      this.picked = { stage, hits: [] };
    }
    const { hits } = this.picked;
    hits.push(hit);
    const points = hits.map(({ point }) => point);
    stage.mark(points, true);
    const [first, second] = hits;
    if (first === undefined || second === undefined) {
      this.say("First point picked; pick the second.");
      return;
    }
    const straight = `Straight distance: ${number(first.point.distanceTo(second.point))} mm`;
    this.say(`${straight}; along the skin: measuring …`);
    const asked = this.picked;
    // Let that be drawn first: a long way over a fine mesh takes a second.
    setTimeout(() => {
      if (this.picked !== asked) return;
      const way = stage.way(first, second);
      stage.mark(points, true, way?.points);
      this.say(
        way === null
          ? `${straight}; no path on the surface joins these points.`
          : `${straight}; along the skin: ${number(way.length)} mm (at most 0.5 % too long).`,
      );
    }, 30);
  }

  private forget(): void {
    this.picked = null;
    this.each((stage) => stage.mark([], false));
    this.say(pressed(this.toggles.measure) ? "Pick two points on the surface." : "");
  }

  private async save(): Promise<void> {
    for (const stage of this.stages) {
      const picture = await stage.picture();
      if (picture === null) continue;
      const link = document.createElement("a");
      link.href = URL.createObjectURL(picture);
      link.download = `${stage.model.name}-${this.controls.look.value}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    }
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    const stage = this.stages.find(({ canvas }) => canvas === document.activeElement) ?? this.stages[0];
    if (stage === undefined || (event.target instanceof HTMLInputElement && event.key.startsWith("Arrow"))) return;
    const direction = Object.keys(DIRECTIONS)[Number(event.key) - 1];
    const acts: Record<string, () => void> = {
      ArrowLeft: () => stage.turn(-TURN_RAD, 0),
      ArrowRight: () => stage.turn(TURN_RAD, 0),
      ArrowUp: () => stage.turn(0, TURN_RAD),
      ArrowDown: () => stage.turn(0, -TURN_RAD),
      "+": () => stage.turn(0, 0, 1.15),
      "-": () => stage.turn(0, 0, 1 / 1.15),
      b: () => this.toggles.boundary.click(),
      l: () => this.toggles.lengths.click(),
      w: () => this.toggles.wall.click(),
      m: () => this.toggles.measure.click(),
      s: () => void this.save(),
    };
    const act = direction !== undefined ? () => stage.face(direction) : acts[event.key];
    if (act === undefined) return;
    act();
    event.preventDefault();
  }

  private each(act: (stage: Stage) => unknown): void {
    for (const stage of this.stages) act(stage);
  }

  private say(words: string): void {
    this.readout.textContent =
      words || "Drag to turn, wheel or pinch to zoom, two fingers or right button to move; click the surface to read it.";
  }
}

export function element<K extends keyof HTMLElementTagNameMap>(
  parent: HTMLElement,
  tag: K,
  name: string,
): HTMLElementTagNameMap[K] {
  const made = parent.appendChild(document.createElement(tag));
  if (name) made.className = name;
  return made;
}

export function button(parent: HTMLElement, text: string, help: string, act: () => void): HTMLButtonElement {
  const made = element(parent, "button", "");
  Object.assign(made, { type: "button", textContent: text, title: help, onclick: act });
  return made;
}

function toggle(parent: HTMLElement, text: string, help: string, on: boolean, act: () => void): HTMLButtonElement {
  const made = button(parent, text, help, () => {
    made.setAttribute("aria-pressed", String(!pressed(made)));
    act();
  });
  made.setAttribute("aria-pressed", String(on));
  return made;
}

function capital(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

function pressed(of: HTMLButtonElement): boolean {
  return of.getAttribute("aria-pressed") === "true";
}

export function choose(parent: HTMLElement, text: string, options: [string, string][]): HTMLSelectElement {
  const label = element(parent, "label", "");
  element(label, "span", "").textContent = text;
  const select = element(label, "select", "");
  select.append(...options.map(([value, title]) => new Option(title, value)));
  return select;
}
