/** Menus of the page's head: one open at a time; Escape and a press elsewhere close it. */

export function closeMenus(): void {
  const menus = [...document.querySelectorAll<HTMLDetailsElement>("[data-drop-down]")];
  document.addEventListener("click", (event) => {
    for (const menu of menus) if (!menu.contains(event.target as Node)) menu.open = false;
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    for (const menu of menus) {
      if (!menu.open) continue;
      menu.open = false;
      menu.querySelector("summary")!.focus();
    }
  });
}
