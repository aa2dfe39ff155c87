/* The feed's end in the page: one WebSocket, opened again whenever it closes, with a longer wait each time. */

const WAITS = [250, 500, 1000, 2000, 5000];

export function listen({ token, onHeader, onRecord, onState }) {
  let tries = 0;
  let session = null, last = -1;
  function open() {
    // What it has, so that only what it missed is sent. The token goes as a protocol's name: not into any URL or log.
    const from = session === null ? "" : `?session=${encodeURIComponent(session)}&after=${last}`;
    const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/feed${from}`;
    const socket = new WebSocket(url, token ? ["skyrelay-live-1", "token." + token] : ["skyrelay-live-1"]);
    socket.onopen = () => {
      tries = 0;
      onState("connected");
    };
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.format !== undefined) {
        if (message.session !== session) last = -1;
        session = message.session;
        onHeader(message);
        return;
      }
      last = message.step;
      onRecord(message);
    };
    socket.onclose = ({ code }) => {
      if (code === 4001) return onState("ended");
      onState("away");
      setTimeout(open, WAITS[Math.min(tries++, WAITS.length - 1)]);
    };
  }
  open();
}
