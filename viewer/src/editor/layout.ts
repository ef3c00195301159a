/** How high the picture is: it fills the window, as far as the page's head leaves room. */

const BELOW_PX = 16;
/** Least share of the window. Where the head leaves less, the picture is this high, and the page is scrolled. */
const LEAST = 0.62;

export function fillWindow(picture: HTMLElement): void {
  const fit = (): void => {
    const top = picture.getBoundingClientRect().top + window.scrollY;
    const height = Math.max(window.innerHeight - top - BELOW_PX, LEAST * window.innerHeight);
    picture.style.setProperty("--mm-high", `${Math.round(height)}px`);
  };
  fit();
  window.addEventListener("resize", fit);
}
