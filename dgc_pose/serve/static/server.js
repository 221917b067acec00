// Requests to the server.

const token = document.querySelector("meta[name=token]").content;
const GONE = 410; // the status of an image that the server has dropped
const SILENT = "the server does not answer: is dgc-pose serve still running?";

/** The server's answer. Raises an Error with its text, and the status if there is one. */
async function send(path, body, type) {
  const headers = { "x-dgc-pose-token": token, "content-type": type };
  const answer = await fetch(path, { method: "POST", headers, body }).catch(() => null);
  if (answer === null) throw new Error(SILENT);
  if (answer.ok) return answer;
  throw Object.assign(new Error(await answer.text()), { status: answer.status });
}

/** Send a photograph. Returns the server's description, with a function that sends it again. */
export async function sendFile(file) {
  try {
    const content = await file.arrayBuffer().catch(() => { throw new Error("the file cannot be read"); });
    const answer = await send(`/images?name=${encodeURIComponent(file.name)}`, content, "application/octet-stream");
    return { ...await answer.json(), again: () => sendFile(file) };
  } catch (error) {
    throw new Error(`${file.name}: ${error.message}`);
  }
}

/** The bundled photographs as files. */
export function bundledPair() {
  return Promise.all(["image1.jpg", "image2.jpg"].map(async (name) => {
    const answer = await fetch(`/static/photographs/${name}`).catch(() => { throw new Error(SILENT); });
    return new File([await answer.blob()], name);
  }));
}

/** Yield the progress, and then the result; raises an Error from the server. Images that the server
    has dropped are sent again. */
export async function* estimated(images, camera) {
  const request = () => send(
    "/poses", JSON.stringify({ image1: images[0].id, image2: images[1].id, camera }), "application/json",
  );
  let answer;
  try {
    answer = await request();
  } catch (error) {
    if (error.status !== GONE) throw error;
    for (const image of images) image.id = (await image.again()).id;
    answer = await request();
  }
  for await (const line of lines(answer.body)) {
    if (line.error) throw new Error(line.error);
    yield line;
  }
}

async function* lines(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read().catch(() => { throw new Error(SILENT); });
    if (done) return;
    const parts = (rest + value).split("\n");
    rest = parts.pop();
    for (const part of parts) yield JSON.parse(part);
  }
}
