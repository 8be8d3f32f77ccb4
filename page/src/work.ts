/** What runs in the background: a strip below the bar in every view; its end reaches who started it. */

import { live, upload, type Job } from "./net";
import { alarm, bytes, h, recall, seconds, setText, store } from "./ui";

interface Mine {
  folders: string[];
}

const started = new Set<number>();
const strip = h("ul", { class: "work", "aria-label": "Running now", hidden: true });
const shown = new Map<string, HTMLAnchorElement>();
let sending = "";

/** The strip; it is there only while something runs. */
export function workStrip(): HTMLElement {
  live.onSlow(look);
  return strip;
}

/** Whether the next diagnosis has to wait. */
export function isDiagnosing(): boolean {
  return started.size > 0 || live.slow.jobs.some((job) => job.kind === "diagnosis" && job.state === "running");
}

/** Note that this browser has started a diagnosis. */
export function startedHere(number: number): void {
  started.add(number);
}

/** Send a log, whichever view is open meanwhile. */
export async function send(file: File): Promise<number> {
  sending = file.name;
  look();
  try {
    return await upload(file);
  } catch (error) {
    alarm("upload", `${file.name} was not uploaded: ${(error as Error).message}`);
    throw error;
  } finally {
    sending = "";
    look();
  }
}

function look(): void {
  const { board, jobs } = live.slow;
  const items = new Map<string, [view: string, text: string]>();
  if (board.recording) items.set("recording", ["time", `Recording ${board.recording.name}, ${bytes(board.recording.bytes)}`]);
  if (board.scenario) items.set("scenario", ["signals", `Scenario ${board.scenario.name}, ${seconds(board.scenario.seconds)} of ${seconds(board.scenario.length_s)}`]);
  if (sending) items.set("upload", ["diagnosis", `Uploading ${sending}`]);
  for (const job of jobs) {
    if (job.state !== "running") continue;
    const share = job.kind === "diagnosis" ? `, ${Math.round(job.share * 100)} %${waiting(jobs)}` : "";
    items.set(job.kind, ["diagnosis", `${job.kind === "diagnosis" ? "Diagnosis" : "Comparison"} of ${job.log}${share}`]);
  }
  for (const [key, link] of shown) {
    if (items.has(key)) continue;
    link.parentElement!.remove();
    shown.delete(key);
  }
  for (const [key, [view, text]] of items) {
    let link = shown.get(key);
    if (!link) {
      link = h("a", { href: `#${view}` });
      shown.set(key, link);
      strip.append(h("li", {}, link));
    }
    setText(link, text);
  }
  strip.hidden = !items.size;
  tellEnds(jobs);
}

function waiting(jobs: Job[]): string {
  const count = jobs.filter((job) => job.state === "waiting").length;
  return count ? `, ${count} waiting` : "";
}

/** Say how the diagnoses have ended that this browser has started, after a reload as well. */
function tellEnds(jobs: Job[]): void {
  const mine = new Set(recall<Mine>("mine").folders ?? []);
  const before = mine.size;
  let ended = 0;
  for (const job of jobs) {
    if (started.delete(job.number)) mine.add(job.folder);
    if (!mine.has(job.folder) || (job.state !== "done" && job.state !== "failed")) continue;
    mine.delete(job.folder);
    ended++;
    if (job.kind === "comparison" && job.state === "done" && location.hash === "#diagnosis") continue; // it is shown there
    const what = job.state === "done" ? "is done" : "has failed";
    alarm(`job ${job.number}`, `The ${job.kind} of ${job.log} ${what}.`, { calm: job.state === "done", href: "#diagnosis", label: "Show it" });
  }
  if (ended || mine.size !== before) store("mine", { folders: [...mine].slice(-50) } satisfies Mine);
}
