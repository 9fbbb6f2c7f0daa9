// Reads the code of a card from a picture or the camera. The wallet's program on this computer looks at the picture; it goes
// nowhere else and is kept nowhere. Must never leave the camera on.

import { announce, h, replace } from "./shared/dom.js";
import { post } from "./api.js";
import { problemCard } from "./pieces.js";
import { t } from "./texts.js";

const SIDE_MAX_PX = 1200;
const CAMERA_EVERY_MS = 400;
const QUALITY = 0.85;

/** The buttons, and what came of them. `onCode` gets the code; `signal` ends the camera with the view. */
export function scanner(onCode, signal) {
  const result = h("div", {});
  const file = h("input", { type: "file", id: "register-picture", accept: "image/*", onchange: () => fromFile() });
  const camera = h("button", { type: "button", onclick: () => (stop ? stop() : fromCamera()) }, t("register.camera"));
  let stop = null;
  let isAsking = false;

  const found = (code) => {
    replace(result, h("p", { role: "status" }, t("register.read")));
    announce(t("register.read"));
    onCode(code);
  };

  const fromFile = async () => {
    const [chosen] = file.files;
    if (!chosen) return;
    stop?.();
    try {
      const picture = await createImageBitmap(chosen).catch(() => null);
      if (picture === null) {
        replace(result, h("p", { class: "notice bad", role: "alert" }, t("register.pictureNone")));
        return;
      }
      found(await read(picture, picture.width, picture.height, signal));
    } catch (error) {
      if (error.name !== "AbortError") replace(result, problemCard(error));
    } finally {
      file.value = "";
    }
  };

  const fromCamera = async () => {
    if (isAsking) return;
    isAsking = true;
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
    } catch (error) {
      replace(result, h("p", { class: "notice bad", role: "alert" }, t("register.cameraNone", { reason: error.message || error.name })));
      return;
    } finally {
      isAsking = false;
    }
    if (signal?.aborted) { // the view was left while the browser asked
      stream.getTracks().forEach((track) => track.stop());
      return;
    }
    const video = h("video", { class: "camera", muted: true, playsinline: true, "aria-hidden": "true" });
    stop = () => {
      stop = null;
      stream.getTracks().forEach((track) => track.stop());
      video.remove();
      replace(camera, t("register.camera"));
      if (result.querySelector(".hold")) replace(result);
    };
    signal?.addEventListener("abort", () => stop?.(), { once: true });
    video.srcObject = stream;
    replace(camera, t("register.cameraStop"));
    replace(result, h("p", { class: "hold" }, t("register.cameraHold")), video);
    await video.play().catch(() => {});
    while (stop) {
      await new Promise((done) => { setTimeout(done, CAMERA_EVERY_MS); });
      if (!stop || video.videoWidth === 0) continue;
      try {
        const code = await read(video, video.videoWidth, video.videoHeight, signal);
        stop?.();
        found(code);
      } catch (error) {
        if (error.code === "QR_UNREADABLE") continue; // no code before it yet
        stop?.();
        if (error.name !== "AbortError") replace(result, problemCard(error));
      }
    }
  };

  return h("div", { class: "field" },
    h("label", { for: "register-picture" }, t("register.picture")), h("div", { class: "row" }, file, navigator.mediaDevices && camera), result);
}

/** Send a picture, made small, and return the code in it. */
async function read(source, width, height, signal) {
  const scale = Math.min(1, SIDE_MAX_PX / Math.max(width, height));
  const canvas = h("canvas", { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) });
  canvas.getContext("2d").drawImage(source, 0, 0, canvas.width, canvas.height);
  const { code } = await post("registration/picture", { picture: canvas.toDataURL("image/jpeg", QUALITY).split(",")[1] }, signal);
  return code;
}
