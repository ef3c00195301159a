/** Requests of our own scripts. Where the session has ended, the person logs in on this page and the request is repeated. */

import { loggedIn } from "./login";

export interface Reply {
  error?: string;
  /** The page's token is from before the last login. */
  stale?: boolean;
}

/** A request was refused; the message is the server's sentence. */
export class Refused extends Error {
  constructor(
    message: string,
    readonly status: number,
    readonly reply: Reply,
  ) {
    super(message);
  }
}

interface Call {
  method?: string;
  /** Sent as JSON; `body` goes as it is. */
  json?: object;
  body?: BodyInit;
  headers?: Record<string, string>;
}

/**
 * Send a request, and read the JSON of its answer.
 *
 * Throws `Refused` with the server's sentence, and `TypeError` where the server cannot be reached.
 */
export async function request<T>(address: string, call: Call = {}): Promise<T> {
  for (let renewed = false; ; renewed = true) {
    const { token } = document.body.dataset;
    const headers: Record<string, string> = { Accept: "application/json", ...call.headers };
    if (token) headers["X-CSRFToken"] = token;
    if (call.json !== undefined) headers["Content-Type"] = "application/json";
    const method = call.method ?? (call.json === undefined ? "GET" : "POST");
    const body = call.json === undefined ? (call.body ?? null) : JSON.stringify(call.json);
    const response = await fetch(address, { method, headers, body });
    if (response.status === 204) return undefined as T;
    const reply = (await response.json().catch(() => null)) as Reply | null;
    if (response.ok && reply !== null) return reply as T;
    const refused = new Refused(reply?.error ?? `The server did not answer as expected (${response.status}).`, response.status, reply ?? {});
    const ended = response.status === 401 || (reply?.stale === true && !renewed);
    if (!ended || !(await loggedIn())) throw refused;
  }
}
