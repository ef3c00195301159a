/** Starts the viewer: in a report the scene stands in the page; a page of the clinic says where to ask for it. */

import type { PackedScene } from "./format";
import { Viewer } from "./viewer";

async function start(): Promise<void> {
  const root = document.getElementById("mm-viewer");
  if (root === null) return;
  try {
    const scene = await sceneOf(root);
    if (scene === null) return;
    root.replaceChildren(); // the words that it is loading
    const viewer = await Viewer.create(root, scene);
    root.dataset.ready = String(viewer.stages.length);
  } catch (error) {
    root.replaceChildren();
    root.textContent = `The 3D view cannot be shown here (${error instanceof Error ? error.message : String(error)}). The pictures on this page show the same surface.`;
    root.dataset.ready = "0";
  }
}

async function sceneOf(root: HTMLElement): Promise<PackedScene | null> {
  if (root.dataset.scene === undefined) {
    const data = document.getElementById("mm-scene");
    return data === null ? null : (JSON.parse(data.textContent) as PackedScene);
  }
  const response = await fetch(root.dataset.scene, { headers: { Accept: "application/json" } });
  if (!response.ok) throw new Error("the surface could not be loaded");
  return (await response.json()) as PackedScene;
}

void start();
