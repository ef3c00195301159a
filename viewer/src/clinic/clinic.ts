/** Everything that moves on the clinic's pages; three dimensions have bundles of their own. */

import htmx from "htmx.org";

import { askFirst } from "./ask";
import { drawBoard } from "./board";
import { keepDrafts } from "./drafts";
import { closeMenus } from "./drop_down";
import { sendForms } from "./forms";
import { loggedIn } from "./login";
import { postForms } from "./post";
import { followJobs } from "./progress";
import { takePhotographs } from "./uploads";

htmx.config.allowEval = false; // the pages' content security policy allows none
htmx.config.allowScriptTags = false;
htmx.config.includeIndicatorStyles = false;
htmx.config.selfRequestsOnly = true;
htmx.config.historyCacheSize = 0; // nothing of a patient stays in the browser

document.addEventListener("htmx:responseError", (event) => {
  if ((event as CustomEvent<{ xhr: XMLHttpRequest }>).detail.xhr.status === 401)
    void loggedIn().then((back) => back && window.location.reload());
});

askFirst();
closeMenus();
postForms();
keepDrafts();
sendForms();
followJobs();
takePhotographs();
drawBoard();
