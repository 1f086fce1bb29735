//! Every limit of the server in one place: what a request, a session and the whole program may use.

/// Most bytes of an uploaded capture, as sent and as unpacked.
pub const UPLOAD_BYTES: u64 = 1 << 30;
/// Most files of an uploaded capture.
pub const UPLOAD_FILES: usize = 4096;
/// Most pixels of one uploaded image: 8192 × 4096.
pub const IMAGE_PIXELS: u64 = 1 << 25;
/// Most pixels of all uploaded images together; decoded they take 16 bytes each.
pub const UPLOAD_PIXELS: u64 = 1 << 27;
/// Most bytes of a JSON file in an upload; parsed it takes some twenty times as many.
pub const JSON_BYTES: u64 = 16 << 20;
/// Uploads that are received at the same time.
pub const RECEIVING: usize = 4;
/// Uploads that wait to be encoded; the oldest goes first.
pub const UPLOADS: usize = 4;
/// Most bytes of an environment map.
pub const MAP_BYTES: usize = 64 << 20;
/// Environment maps that can be held.
pub const MAPS: usize = 128;
/// Most bytes of a session file: full of tokens, and everything else that goes with them.
pub const SESSION_BYTES: usize = TOKEN_BYTES + (1 << 28);
/// Sessions in memory; others wait on disk.
pub const OPEN_SESSIONS: usize = 16;
/// Sessions on disk.
pub const SAVED_SESSIONS: usize = 512;
/// Steps of a session, removed ones included.
pub const NODES: usize = 2000;
/// Removals of one session that can be taken back, as many as the page can undo; the oldest is forgotten first.
pub const REMOVALS: usize = 200;
/// Steps that a change of one of them may make anew.
pub const RELIT: usize = 64;
/// Most bytes of scene tokens in one session.
pub const TOKEN_BYTES: usize = 1 << 29;
/// Steps that keep what the decoder has prepared of them, over all sessions: looking at another one first costs a little.
pub const PREPARED: usize = 16;
/// Lights of one edit.
pub const LIGHTS: usize = 16;
/// Characters of a step's name.
pub const NAME: usize = 60;
/// Edits of a draft.
pub const DRAFT: usize = 64;
/// Most bytes of scene tokens that a page's draft keeps beside the last ones; more is made again when it is asked for.
pub const DRAFT_BYTES: usize = 1 << 25;
/// WebSocket connections.
pub const SOCKETS: usize = 128;
/// Most bytes of a WebSocket message or of a JSON body.
pub const MESSAGE_BYTES: usize = 64 << 10;
/// Input views that a scene is encoded from.
pub const INPUTS: usize = 32;
/// Frames of a turntable.
pub const TURNTABLE_FRAMES: usize = 120;
/// Largest side of an exported picture, in pixels.
pub const EXPORT_SIDE: usize = 2048;

/// What can be saved can be opened: besides tokens a file holds every map at its largest (256 × 128 pixels of three
/// floats), the inputs at 1024 pixels a side, half a KiB of text for every light, and the steps' names.
const _: () = assert!(
    MAPS * 256 * 128 * 12
        + INPUTS * 1024 * 1024 * 3
        + NODES * (LIGHTS * 512 + NAME * 8)
        + TOKEN_BYTES
        <= SESSION_BYTES
);
