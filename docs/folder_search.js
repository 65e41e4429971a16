// Browsers start no worker for a page that was opened from a folder: there, a hidden frame does a worker's work, and search works.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const base = new URL(url, location.href).href;
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      const inside = frame.contentWindow, page = frame.contentDocument;
      const load = (source) => new Promise((done, failed) => {
        const script = page.createElement("script");
        script.src = new URL(source, base).href;
        script.onload = done;
        script.onerror = failed;
        page.body.append(script);
      });
      const receive = inside.postMessage.bind(inside);
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inside.importScripts = (...sources) => sources.reduce((before, source) => before.then(() => load(source)), Promise.resolve());
      this.ready = load(base);
      this.receive = (data) => receive(data, "*");
    }
    postMessage(data) {
      this.ready.then(() => this.receive(data));
    }
    terminate() {}
  };
}
