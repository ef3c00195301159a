/** Everything that moves on the clinic's pages; three dimensions have bundles of their own. */

import htmx from "htmx.org";

import { askFirst } from "./ask";
import { closeMenus } from "./drop_down";
import { postForms } from "./post";
import { followJobs } from "./progress";
import { takePhotographs } from "./uploads";

htmx.config.allowEval = false; // the pages' content security policy allows none
htmx.config.allowScriptTags = false;
htmx.config.includeIndicatorStyles = false;
htmx.config.selfRequestsOnly = true;
htmx.config.historyCacheSize = 0; // nothing of a patient stays in the browser

askFirst();
closeMenus();
postForms();
followJobs();
takePhotographs();
