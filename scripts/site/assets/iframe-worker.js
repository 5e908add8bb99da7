/* Search in a site that is opened from a folder: browsers refuse workers of file:// pages, so the
   worker's script runs in a hidden frame instead. */
(function () {
  if (location.protocol !== "file:") return;

  class FrameWorker extends EventTarget {
    constructor(url) {
      super();
      this.onmessage = null;
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.appendChild(frame);
      this.scope = frame.contentWindow;
      const receive = (data) => {
        const event = new MessageEvent("message", { data });
        this.dispatchEvent(event);
        if (this.onmessage) this.onmessage(event);
      };
      const page = this.scope.document;
      page.open();
      this.scope.postMessage = (data) => setTimeout(receive, 0, data);
      this.scope.importScripts = () => {};
      this.ready = new Promise((resolve) => {
        const script = page.createElement("script");
        script.src = new URL(url, location.href).href;
        script.onload = resolve;
        page.write("<html><head></head><body></body></html>");
        page.close();
        page.head.appendChild(script);
      });
    }

    postMessage(data) {
      this.ready.then(() => {
        this.scope.dispatchEvent(new this.scope.MessageEvent("message", { data }));
      });
    }

    terminate() {}
  }

  window.Worker = FrameWorker;
})();
