// Runs in every browser before viser's own client does; `app/view/script.py` puts it into the page.
(() => {
  "use strict";

  // Without a graphics card the processor draws. Smoothing every edge then costs half of all the
  // time that a picture takes, so those browsers do without.
  const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
  const draws_in_software = () => {
    const gl = document.createElement("canvas").getContext("webgl2");
    if (gl === null) return false;
    const named = gl.getExtension("WEBGL_debug_renderer_info");
    const name = gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    return SOFTWARE.test(name);
  };
  if (draws_in_software()) {
    const theirs = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, wanted) {
      if (String(kind).startsWith("webgl")) wanted = { ...wanted, antialias: false };
      return theirs.call(this, kind, wanted);
    };
  }

  // A camera is told with the size of its picture in the page's pixels, which is what labels are
  // sized in; viser's client tells that of its canvas, in pixels of some other size.
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (data, ...more) {
    const canvas = document.querySelector("canvas[data-engine]");
    if (data?.message?.type === "ViewerCameraMessage" && canvas !== null) {
      data.message.image_height = canvas.clientHeight;
      data.message.image_width = canvas.clientWidth;
    }
    return post.call(this, data, ...more);
  };

  // Keys act whatever has the focus but a field that is written in. viser's client does not hear
  // keys while any input has the focus, a checkbox or a chosen option among them.
  const OWN = new Set(["Tab", "Enter", " ", "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight",
    "Home", "End", "PageUp", "PageDown", "Shift", "Control", "Alt", "Meta"]);
  const is_text = (element) =>
    element instanceof HTMLInputElement
      ? !["checkbox", "radio", "range", "button", "submit", "file", "color"].includes(element.type)
      : element instanceof HTMLTextAreaElement || element.isContentEditable;
  const pass_on = (event) => {
    const at = event.target;
    if (!event.isTrusted || !(at instanceof HTMLElement)) return;
    if (event.type === "keydown" && event.key === "Escape" && is_text(at)) at.blur();
    if (!(at instanceof HTMLInputElement) || is_text(at) || OWN.has(event.key)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    document.body.dispatchEvent(new KeyboardEvent(event.type, event));
  };
  addEventListener("keydown", pass_on, true);
  addEventListener("keyup", pass_on, true);
  // A dropdown is searched by typing, so it is a text field until something is chosen in it.
  addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest("[role=option]"))
      setTimeout(() => document.activeElement?.blur(), 0);
  });

  // A number field that is left empty shows its value again: viser's client tells nobody about it.
  let entered = null;
  addEventListener("focusin", (event) => {
    const at = event.target;
    entered = at instanceof HTMLInputElement && at.inputMode !== "" ? [at, at.value] : null;
  });
  addEventListener("focusout", (event) => {
    if (entered === null || entered[0] !== event.target || event.target.value.trim() !== "") return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    set.call(event.target, entered[1]);
    event.target.dispatchEvent(new Event("input", { bubbles: true }));
  });
})();
