/** Tells the pages in frames, replays among them, whether this page is light or dark. */

function tell(frame) {
  const theme = document.body.dataset.mdColorScheme === "slate" ? "dark" : "light";
  frame.contentWindow.postMessage({ theme }, "*"); // a frame of its own has no origin
}

function tellAll() {
  for (const frame of document.querySelectorAll("iframe")) tell(frame);
}

// Frames that load as they come into sight, or that a script puts in, are told then.
const tellLoaded = ({ target }) => target.localName === "iframe" && tell(target);
document.addEventListener("load", tellLoaded, { capture: true });
new MutationObserver(tellAll).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
tellAll();
