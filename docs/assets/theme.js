/** Tells the pages in frames, replays among them, whether this page is light or dark. */

const themeOf = () => (document.body.dataset.mdColorScheme === "slate" ? "dark" : "light");

function tell(frame) {
  frame.contentWindow?.postMessage({ theme: themeOf() }, "*"); // a frame of its own has no origin
}

function tellAll() {
  for (const frame of document.querySelectorAll("iframe")) tell(frame);
}

for (const frame of document.querySelectorAll("iframe")) {
  frame.addEventListener("load", () => tell(frame)); // those that load as they come into sight too
}
new MutationObserver(tellAll).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
tellAll();
