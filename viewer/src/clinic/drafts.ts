/**
 * What is typed into a form is kept in this tab until it is saved.
 *
 * It is offered again after a reload or a login, to the same person alone, and removed when the form was accepted, when
 * somebody logs out in any tab, and when another person's page is shown.
 */

interface Draft {
  person: string;
  /** When it was typed, ms since 1970. */
  at: number;
  /** Of the form that was sent last. */
  token: string;
  /** Of the record, as the page showed it. */
  version: string | null;
  /** Name and value of each field; of those to tick, only what is ticked. */
  fields: [string, string][];
}

type Field = HTMLInputElement | HTMLSelectElement | HTMLTextAreaElement;

const BEGIN = "draft ";
const MOST_MS = 12 * 3600 * 1000; // no session lasts longer by default
const TEXT = "textarea, input:not([type]), input[type=text], input[type=email], input[type=number], input[type=date], input[type=datetime-local]";
const NOT_KEPT = ["hidden", "password", "file", "submit", "button"];
const LOGGED_OUT = "logged out";

const channel = "BroadcastChannel" in window ? new BroadcastChannel("clinic") : null;

/** Offer what was not saved, and keep what is typed from now on. */
export function keepDrafts(): void {
  const { person, accepted = "" } = document.body.dataset;
  channel?.addEventListener("message", (event) => event.data === LOGGED_OUT && forget());
  if (person === undefined) return;
  const saved = accepted.split(" ");
  for (const [key, draft] of drafts())
    if (draft === null || draft.person !== person || saved.includes(draft.token) || Date.now() - draft.at > MOST_MS) sessionStorage.removeItem(key);
  for (const form of document.querySelectorAll("form")) if (isKept(form)) offer(form);
  document.addEventListener("input", (event) => {
    const form = (event.target as Field).form;
    if (form != null) keep(form);
  });
}

/** Keep what a form holds now. */
export function keep(form: HTMLFormElement): void {
  const { person } = document.body.dataset;
  if (person === undefined || !isKept(form)) return;
  const draft: Draft = {
    person,
    at: Date.now(),
    token: hidden(form, "form_token")?.value ?? "",
    version: hidden(form, "record_version")?.value ?? null,
    fields: fieldsOf(form),
  };
  try {
    sessionStorage.setItem(keyOf(form), JSON.stringify(draft));
  } catch {
    // The tab's storage is full or switched off: the form itself still holds the text.
  }
}

/** After a log-out no draft stays, in any tab. */
export function forgetEverywhere(): void {
  forget();
  channel?.postMessage(LOGGED_OUT);
}

function forget(): void {
  for (const [key] of drafts()) sessionStorage.removeItem(key);
}

function drafts(): [string, Draft | null][] {
  const keys = Object.keys(sessionStorage).filter((key) => key.startsWith(BEGIN));
  return keys.map((key) => [key, read(key)]);
}

function read(key: string): Draft | null {
  try {
    return JSON.parse(sessionStorage.getItem(key) ?? "null") as Draft | null;
  } catch {
    return null;
  }
}

/** A form with text that is sent to the clinic's pages. That of a login is none. */
function isKept(form: HTMLFormElement): boolean {
  const path = new URL(form.action, window.location.href).pathname;
  return form.method === "post" && form.dataset.noDraft === undefined && !path.startsWith("/account/") && form.querySelector(TEXT) !== null;
}

function keyOf(form: HTMLFormElement): string {
  const { pathname, search } = new URL(form.action, window.location.href);
  return BEGIN + pathname + search;
}

function hidden(form: HTMLFormElement, name: string): HTMLInputElement | null {
  return form.querySelector<HTMLInputElement>(`input[type=hidden][name=${name}]`);
}

function fields(form: HTMLFormElement): Field[] {
  const all = [...form.elements].filter((each) => each instanceof HTMLInputElement || each instanceof HTMLSelectElement || each instanceof HTMLTextAreaElement);
  return all.filter((field) => field.name !== "" && !NOT_KEPT.includes(field.type) && !field.hidden);
}

function isTicked(field: Field): field is HTMLInputElement {
  return field.type === "checkbox" || field.type === "radio";
}

function fieldsOf(form: HTMLFormElement): [string, string][] {
  return fields(form)
    .filter((field) => !isTicked(field) || field.checked)
    .map((field) => [field.name, field.value]);
}

/** Show that there is text that was not saved, before the form's own fields. */
function offer(form: HTMLFormElement): void {
  const draft = read(keyOf(form));
  if (draft === null || JSON.stringify(draft.fields) === JSON.stringify(fieldsOf(form))) return;
  const said = document.createElement("div");
  said.className = "said care draft";
  said.setAttribute("role", "status");
  const strong = document.createElement("strong");
  strong.textContent = "Your entries here were not saved.";
  const when = document.createElement("p");
  const time = new Date(draft.at).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  when.textContent = `It is from ${time}.`;
  const acts = document.createElement("div");
  acts.className = "acts";
  acts.append(
    button("Put it back", "button main", () => {
      said.remove();
      putBack(form, draft);
    }),
    button("Discard it", "button", () => {
      said.remove();
      sessionStorage.removeItem(keyOf(form));
    }),
  );
  said.append(strong, when, acts);
  form.prepend(said);
  const fold = form.closest("details");
  if (fold !== null) fold.open = true;
}

function putBack(form: HTMLFormElement, draft: Draft): void {
  const left = [...draft.fields];
  for (const field of fields(form)) {
    const at = left.findIndex(([name, value]) => name === field.name && (!isTicked(field) || value === field.value));
    if (isTicked(field)) field.checked = at >= 0;
    else if (at >= 0) field.value = left[at]![1];
    if (at >= 0) left.splice(at, 1);
  }
  const version = hidden(form, "record_version"); // a change by others since then is shown when the form is sent
  if (version !== null && draft.version !== null) version.value = draft.version;
  keep(form);
  form.querySelector<HTMLElement>(TEXT)?.focus();
}

function button(text: string, kind: string, act: () => void): HTMLButtonElement {
  const made = document.createElement("button");
  made.type = "button";
  made.className = kind;
  made.textContent = text;
  made.addEventListener("click", act);
  return made;
}
