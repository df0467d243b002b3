/** Begins: the page of a running daemon, or of a log. */

import { startLive } from "./live.js";
import { startLog } from "./log.js";

if (document.documentElement.dataset.source === "log") startLog();
else startLive();
