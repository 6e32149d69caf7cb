// The live WebSocket: connects, connects again, acknowledges frames as they are drawn, so that the bridge sends
// no more than this page can take.

const AGAIN_MS = 1000;
/** A page that is hidden draws nothing, and still wants to know. */
const HIDDEN_MS = 500;

/**
 * Calls `told` with each message and `changed` with "open", "lost" or "over".
 * Returns an object with `stop()`, `mark()` and `show()`, which are false where nobody could be told, and `took()`, to be called when
 * the newest frame has been drawn.
 */
export function connect(told, changed) {
  let socket = null;
  let over = false;
  let waiting = 0;

  function took() {
    for (; waiting > 0; waiting--) {
      if (socket?.readyState === WebSocket.OPEN) socket.send("took");
    }
  }
  setInterval(took, HIDDEN_MS);

  function open() {
    const token = new URLSearchParams(location.search).get("token");
    const query = token === null ? "" : `?token=${encodeURIComponent(token)}`;
    socket = new WebSocket(`ws://${location.host}/live${query}`);
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.over) {
        over = true;
        changed("over");
        return;
      }
      if (message.hello) changed("open");
      else waiting += 1;
      told(message);
    };
    socket.onclose = () => {
      waiting = 0;
      if (!over) changed("lost");
      // A session that starts anew on this port is shown too.
      setTimeout(open, AGAIN_MS);
    };
  }
  open();

  return {
    stop() {
      if (socket?.readyState !== WebSocket.OPEN) return false;
      socket.send("stop");
      return true;
    },
    /** Marks an episode: begin, end, again, good or bad. */
    mark(name) {
      if (socket?.readyState !== WebSocket.OPEN) return false;
      socket.send(`mark ${name}`);
      return true;
    },
    /** The wearer's button: show gestures, send the kept model, or give up. */
    show() {
      if (socket?.readyState !== WebSocket.OPEN) return false;
      socket.send("show");
      return true;
    },
    /** What has come so far is on the screen. */
    took,
    /** A new session has begun to speak. */
    begin() {
      over = false;
    },
  };
}
