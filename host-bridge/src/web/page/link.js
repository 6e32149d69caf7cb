// The live WebSocket: connects, connects again, acknowledges each frame so that the bridge sends no more than
// this page can take.

const AGAIN_MS = 1000;

/**
 * Calls `told` with each message and `changed` with "open", "lost" or "over".
 * Returns an object with `stop()`, which is false where nobody could be told.
 */
export function connect(told, changed) {
  let socket = null;
  let over = false;

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
      else socket.send("took");
      told(message);
    };
    socket.onclose = () => {
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
    /** A new session has begun to speak. */
    begin() {
      over = false;
    },
  };
}
