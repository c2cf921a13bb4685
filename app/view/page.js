// Runs in every browser before viser's client; `app/view/script.py` inserts it into the page.
(() => {
  "use strict";

  // Without a graphics card antialiasing takes half of the rendering time: switch it off.
  const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
  const renders_in_software = () => {
    const gl = document.createElement("canvas").getContext("webgl2");
    if (gl === null) return false;
    const named = gl.getExtension("WEBGL_debug_renderer_info");
    const name = gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    return SOFTWARE.test(name);
  };
  if (renders_in_software()) {
    const original = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, wanted) {
      if (String(kind).startsWith("webgl")) wanted = { ...wanted, antialias: false };
      return original.call(this, kind, wanted);
    };
  }

  // Report the picture's size in CSS pixels, the unit of the labels; viser's client reports the
  // canvas's device pixels.
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (data, ...more) {
    const canvas = document.querySelector("canvas[data-engine]");
    if (data?.message?.type === "ViewerCameraMessage" && canvas !== null) {
      data.message.image_height = canvas.clientHeight;
      data.message.image_width = canvas.clientWidth;
    }
    return post.call(this, data, ...more);
  };

  // viser's client ignores keys while any input has the focus, even a checkbox. Pass them on, unless
  // the input is a text field.
  const NOT_PASSED = new Set(["Tab", "Enter", " ", "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight",
    "Home", "End", "PageUp", "PageDown", "Shift", "Control", "Alt", "Meta"]);
  const is_text = (element) =>
    element instanceof HTMLInputElement
      ? !["checkbox", "radio", "range", "button", "submit", "file", "color"].includes(element.type)
      : element instanceof HTMLTextAreaElement || element.isContentEditable;
  const pass_on = (event) => {
    const at = event.target;
    if (!event.isTrusted || !(at instanceof HTMLElement)) return;
    if (event.type === "keydown" && event.key === "Escape" && is_text(at)) at.blur();
    if (!(at instanceof HTMLInputElement) || is_text(at) || NOT_PASSED.has(event.key)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    document.body.dispatchEvent(new KeyboardEvent(event.type, event));
  };
  addEventListener("keydown", pass_on, true);
  addEventListener("keyup", pass_on, true);
  // A dropdown is a text field for its search: remove the focus once an option is chosen.
  addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest("[role=option]"))
      setTimeout(() => document.activeElement?.blur(), 0);
  });

  // Restore the value of a number field that is left empty: viser's client sends no message then.
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

  // A button in the page's own HTML gives its order through the text field behind that HTML, which is
  // hidden: viser's HTML has no events of its own.
  addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("[data-vf-order]") : null;
    const field = button?.closest(".vf-orders")?.parentElement?.nextElementSibling;
    const input = field?.querySelector("input");
    if (!input) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    set.call(input, `${button.dataset.vfOrder} ${Date.now()}`);
    input.dispatchEvent(new Event("input", { bubbles: true }));
  });

  // What is heard and felt is said by an element of the page's own HTML, several times a second.
  const hand = () => document.querySelector(".vf-hand")?.dataset;
  // What the hand does goes through the text field behind that element, as orders do.
  const tell = (words) => {
    const field = document.querySelector(".vf-hand")?.parentElement?.nextElementSibling;
    const input = field?.querySelector("input");
    if (!input) return;
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    set.call(input, `${words}|${Date.now()}`);
    input.dispatchEvent(new Event("input", { bubbles: true }));
  };
  let audio = null, contacts = null;
  const play = (said) => {
    if (audio === null) {
      if (said?.sound !== "1") return;
      const context = new AudioContext();
      audio = { context, tone: context.createOscillator(), volume: context.createGain() };
      audio.volume.gain.value = 0;
      audio.tone.connect(audio.volume).connect(context.destination);
      audio.tone.start();
    }
    const now = audio.context.currentTime;
    const level = said?.sound === "1" ? Number(said.level) : 0;
    if (said?.sound === "1" && contacts !== null && said.contacts !== contacts) {
      const pulse = audio.context.createOscillator(), fading = audio.context.createGain();
      pulse.frequency.value = 880;
      fading.gain.setValueAtTime(0.25, now);
      fading.gain.exponentialRampToValueAtTime(0.001, now + 0.08);
      pulse.connect(fading).connect(audio.context.destination);
      pulse.start(now);
      pulse.stop(now + 0.08);
      navigator.vibrate?.(30);
    }
    audio.volume.gain.setTargetAtTime(level, now, 0.02);
    if (level > 0) audio.tone.frequency.setTargetAtTime(Number(said.pitch), now, 0.02);
  };
  // Browsers let a page be heard only once it was clicked on.
  addEventListener("click", () => audio?.context.resume(), true);

  // A gamepad's state is told while it is moved, and once when it comes to rest.
  let rested = true;
  const feel = (said) => {
    const pad = said?.gamepad === "1" ? [...navigator.getGamepads()].find((one) => one?.connected) : null;
    if (said?.contacts !== contacts) {
      if (contacts !== null) pad?.vibrationActuator?.playEffect("dual-rumble",
        { duration: 80, strongMagnitude: 0.6, weakMagnitude: 0.3 }).catch(() => {});
      contacts = said?.contacts ?? null;
    }
    const pressed = pad ? pad.buttons.flatMap((button, k) => (button.pressed ? [k] : [])) : [];
    const rests = !pad || (pressed.length === 0 && pad.axes.every((value) => Math.abs(value) < 0.1));
    if (rests && rested) return;
    rested = rests;
    const axes = pad ? pad.axes.map((value) => Math.max(-1, Math.min(1, value)).toFixed(3)) : [];
    tell(`pad:${pad?.mapping ?? ""}|${axes}|${pressed}`);
  };
  setInterval(() => {
    const said = hand();
    play(said);
    if (said) feel(said);
  }, 40);
  // The wheel and a second finger move a tool that is held; viser's client would zoom. They are told as
  // sums, because the client sends only the newest of several texts.
  const fingers = new Map();  // places of the pointers on the picture, by number
  let depth = 0, turn = 0;
  const reach = (more, spin) => {
    depth += more;
    turn += spin;
    tell(`reach:${depth.toFixed(3)}|${turn.toFixed(4)}`);
  };
  const holds = () => fingers.size > 0 && hand()?.held === "1";
  const between = () => {
    const [a, b] = [...fingers.values()];
    return [Math.hypot(b[0] - a[0], b[1] - a[1]), Math.atan2(b[1] - a[1], b[0] - a[0])];
  };
  const second = (event) => event.pointerType === "touch" && !event.isPrimary;
  addEventListener("pointerdown", (event) => {
    if (!(event.target instanceof HTMLCanvasElement) || event.button !== 0 || fingers.size > 1) return;
    if (holds() && second(event)) event.stopImmediatePropagation();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }, true);
  addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = fingers.size === 2 ? between() : null;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (before === null || !holds()) return;
    if (second(event)) event.stopImmediatePropagation();
    const after = between();
    const spin = after[1] - before[1];
    reach((before[0] - after[0]) / 20, Math.atan2(Math.sin(spin), Math.cos(spin)));
  }, true);
  const lifted = (event) => {
    if (fingers.has(event.pointerId) && holds() && second(event)) event.stopImmediatePropagation();
    fingers.delete(event.pointerId);
  };
  addEventListener("pointerup", lifted, true);
  addEventListener("pointercancel", lifted, true);
  addEventListener("wheel", (event) => {
    if (!holds()) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    reach(-event.deltaY / (event.deltaMode === 0 ? 100 : 3), 0);
  }, { capture: true, passive: false });
  // Such a button is replaced with its HTML when that changes, which takes the focus away: give it
  // to the button of the same order.
  let ordering = null;
  addEventListener("focusin", (event) => {
    ordering = event.target instanceof Element ? event.target.closest("[data-vf-order]") : null;
  });
  addEventListener("focusout", () => {
    // Also sent while the button is being removed: afterwards is known which it was.
    const left = ordering;
    queueMicrotask(() => {
      if (left === ordering && left?.isConnected) ordering = null;
    });
  });
  new MutationObserver(() => {
    if (ordering === null || ordering.isConnected) return;
    const lost = document.activeElement === document.body;
    const same = document.querySelector(`[data-vf-order="${ordering.dataset.vfOrder}"]`);
    ordering = null;
    if (lost) same?.focus({ preventScroll: true });
  }).observe(document, { childList: true, subtree: true });
})();
