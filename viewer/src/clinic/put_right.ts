/** Photographs under the names of other cameras, put right by a click: before and after. */

function named(camera: string): string {
  const words = camera.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function element(tag: string, kind: string, text = ""): HTMLElement {
  const made = document.createElement(tag);
  if (kind !== "") made.className = kind;
  if (text !== "") made.textContent = text;
  return made;
}

function pressed(words: string, name: string, value: object): HTMLElement {
  const button = element("button", "button", words) as HTMLButtonElement;
  button.type = "button";
  button.dataset[name] = JSON.stringify(value);
  return button;
}

function shot(thumbnail: string | null | undefined, words: string): HTMLElement {
  const box = element("div", "shot");
  if (thumbnail) {
    const image = element("img", "") as HTMLImageElement;
    image.src = thumbnail;
    image.alt = words;
    box.append(image);
  }
  return box;
}

/** For each camera of an exchange its photograph now and afterwards, and the button that puts all right. */
export function exchangedPart(exchanged: Record<string, string>, shots: Record<string, string | null>): HTMLElement[] {
  const cameras = Object.keys(exchanged);
  if (cameras.length === 0) return [];
  const list = element("ul", "places");
  for (const camera of cameras) {
    const item = element("li", "place");
    item.append(
      element("h3", "", named(camera)),
      element("p", "small faint", "Now"),
      shot(shots[camera], `${named(camera)} now`),
      element("p", "small faint", "After"),
      shot(shots[exchanged[camera]!], `${named(camera)} after the correction`),
    );
    list.append(item);
  }
  const acts = element("div", "acts");
  acts.append(pressed("Put them right", "putRight", exchanged));
  return [list, acts];
}

/** The camera that took a photograph of an unknown camera, by the calibration. */
export function suggested(address: string, camera: string): HTMLElement[] {
  return [element("p", "", `By the calibration: ${named(camera)}.`), pressed(`It is of ${named(camera)}`, "put", { [address]: camera })];
}

/** The button that follows the calibration for all such photographs. */
export function suggestedForAll(unplaced: { id: string; url: string }[], told: Record<string, string>): HTMLElement[] {
  const put = Object.fromEntries(unplaced.flatMap(({ id, url }) => (told[id] === undefined ? [] : [[url, told[id]]])));
  if (Object.keys(put).length < 2) return [];
  const item = element("li", "place");
  item.append(element("p", "", "The calibration shows which camera took each photograph."), pressed("Put all in their places", "put", put));
  return [item];
}
