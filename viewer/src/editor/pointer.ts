/** The mouse over the picture: it takes hold of points, drags them, and adds new ones. The rest turns the surface. */

import type { Vector3 } from "three";

import type { Stage } from "../stage";

const CLICK_PX = 4;

export interface Pointed {
  /** Whether points can be changed now. */
  canDraw(): boolean;
  /** The point under the pointer. */
  handleAt(clientX: number, clientY: number): number | null;
  grabbed(index: number): void;
  dragged(index: number, to: Vector3): void;
  /** After a point was dragged. */
  dropped(): void;
  clicked(at: Vector3): void;
}

export function followPointer(stage: Stage, pointed: Pointed): void {
  const { canvas } = stage;
  let held: { index: number; moved: boolean } | null = null;
  let pressed: [number, number] | null = null;
  // Before the orbit controls hear of it: a grabbed point moves, the model stays.
  canvas.parentElement!.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button !== 0 || !pointed.canDraw()) return;
      pressed = [event.clientX, event.clientY];
      const index = pointed.handleAt(event.clientX, event.clientY);
      if (index === null) return;
      stage.holdStill(true);
      held = { index, moved: false };
      pointed.grabbed(index);
    },
    { capture: true },
  );
  canvas.addEventListener("pointermove", (event) => {
    const hit = held === null ? null : stage.pick(event.clientX, event.clientY);
    if (held === null || hit === null) return;
    held.moved = true;
    pointed.dragged(held.index, hit.point);
  });
  canvas.addEventListener("pointerup", (event) => {
    const dropped = held;
    held = null;
    stage.holdStill(false);
    if (dropped?.moved === true) pointed.dropped();
    else if (dropped === null && pressed !== null && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < CLICK_PX) {
      const hit = stage.pick(event.clientX, event.clientY);
      if (hit !== null) pointed.clicked(hit.point);
    }
    pressed = null;
  });
}
