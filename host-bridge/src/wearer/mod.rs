//! The first minute: the wearer of the right hand shows each gesture three times.
//! The board then gets a model that was trained with these recordings.
//!
//! ```text
//! key, page ─► Wearer ─ text, button ─► terminal, page, JSON
//! board ◄────►   │  Showing: record mode, takes, the model's way back
//!                └─► a thread of its own: files, learning ─► kept in FOLDER/NAME
//! ```
//!
//! The control thread polls this in every turn and never waits. The other thread reads files and trains.
//! Gestures that are shown move nothing. The board sends samples instead of gestures,
//! and the bridge ignores all gestures until the new model is on the board.

mod kept;

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use host_core::bridge::Prompt;
use host_core::engine::{Engine, FOREIGN_REQUESTS};
use host_core::safety::Hand;
use host_links::links::Clock;
use host_links::showing::{Showing, Shown, TIMES};
use host_links::upload::Upload;
use host_robot::Door;

pub use kept::{Kept, next_file};

/// Range of request numbers that one showing may use.
const REQUESTS: u16 = 0x400;
/// After the last example, gestures have no effect for this time.
/// The board's window may still contain that gesture.
const AFTER_MS: u64 = 3000;
/// Interval at which the other thread checks whether the session is over.
const PATIENCE: Duration = Duration::from_secs(3600);
const THREAD_ENDED: &str = "nothing can be learnt: a thread of this program has ended; start it again";

/// The wearer of the right hand, and the place where wearers' models are stored.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The name that the user gave.
    pub name: Option<String>,
    /// The folder that contains a folder for each wearer.
    pub folder: PathBuf,
    /// The model to start from; `None` means the bundled one.
    pub model: Option<PathBuf>,
}

/// The action that the wearer can take now.
#[derive(Clone, Debug, PartialEq)]
enum Offer {
    /// No board has reported its model yet.
    Looking,
    /// The wearer can show each of these gestures.
    Show { labels: Vec<String>, text: String },
    /// The board can get the wearer's stored model.
    Send { blob: Vec<u8>, text: String },
    /// No action is possible, for this reason.
    Cannot(String),
}

/// A job for the other thread.
enum Job {
    /// Find out what the wearer can do with a board that runs this model.
    Look { model_id: u32, labels: Vec<String> },
    /// Train with the recordings that were shown.
    Learn(Shown),
}

enum Answer {
    Offer(Offer),
    Learnt(Result<Vec<u8>, String>),
}

/// The wearer of the right hand during the first minute, see the module documentation.
pub struct Wearer {
    jobs: SyncSender<Job>,
    answers: Receiver<Answer>,
    offer: Offer,
    showing: Option<Showing>,
    /// Number of showings so far. It gives each showing its own request numbers.
    showings: u16,
    /// Number of jobs that the other thread has not answered.
    unanswered: usize,
    /// The board's start and model, as of the last check.
    board: Option<(u32, u32)>,
    /// The result of the last showing.
    result: Option<String>,
    told: String,
    held_until_ms: u64,
    pressed: bool,
}

impl Wearer {
    /// Starts the wearer's own thread, which uses the time of `clock`.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start(settings: Settings, clock: &dyn Clock) -> std::io::Result<Self> {
        let (jobs, incoming) = sync_channel::<Job>(4);
        let (outgoing, answers) = sync_channel(4);
        // With this waiter, the clock knows when the other thread reads or trains.
        let waiter = clock.waiter();
        std::thread::Builder::new().name("wearer".to_owned()).spawn(move || {
            let mut kept = Kept::new(settings);
            loop {
                let job = match waiter.receive(&incoming, PATIENCE) {
                    Ok(job) => job,
                    // A session may last longer than an hour while no job arrives.
                    Err(RecvTimeoutError::Timeout) => continue,
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                let answer = match job {
                    Job::Look { model_id, labels } => Answer::Offer(kept.offer(model_id, &labels)),
                    Job::Learn(shown) => Answer::Learnt(kept.learn(&shown)),
                };
                if outgoing.send(answer).is_err() {
                    break;
                }
            }
        })?;
        Ok(Wearer {
            jobs,
            answers,
            offer: Offer::Looking,
            showing: None,
            showings: 0,
            unanswered: 0,
            board: None,
            result: None,
            told: String::new(),
            held_until_ms: 0,
            pressed: false,
        })
    }

    /// Processes the key or the page's button, which begins an action or cancels the action in progress.
    pub fn press(&mut self) {
        self.pressed = true;
    }

    /// Processes bytes from the right hand's board.
    pub fn receive(&mut self, bytes: &[u8], now_ms: u64) {
        if let Some(showing) = &mut self.showing {
            showing.receive(bytes, now_ms);
        }
    }

    /// Waits for the other thread.
    /// Only tests with virtual time call this, because the control thread never waits.
    pub fn settle(&mut self, now_ms: u64) {
        while self.unanswered > 0
            && let Ok(answer) = self.answers.recv()
        {
            self.take(answer, now_ms);
        }
    }

    /// Performs one turn of the control thread. `ready` means that the board's link accepts bytes.
    pub fn turn<D: Door>(&mut self, engine: &mut Engine<'static, D>, ready: bool, now_ms: u64) {
        self.look(engine);
        self.answered(now_ms);
        if std::mem::take(&mut self.pressed) {
            self.begin_or_cancel(engine, now_ms);
        }
        if let Some(showing) = &mut self.showing {
            if ready && let Some(message) = showing.poll(now_ms) {
                engine.send_to(Hand::Right, &message, now_ms);
            }
            if let Some(shown) = showing.take_shown() {
                match self.jobs.try_send(Job::Learn(shown)) {
                    Ok(()) => self.unanswered += 1,
                    Err(_) => showing.learnt(Err(THREAD_ENDED.to_owned()), now_ms),
                }
            }
            if showing.holds_gestures() {
                self.held_until_ms = now_ms + AFTER_MS;
            }
        }
        let mut prompt = self.prompt();
        if let Some(Prompt { text, .. }) = &prompt {
            self.tell(text, engine, now_ms);
        }
        if self.showing.as_ref().is_some_and(Showing::is_over) {
            self.result = self.showing.take().map(|showing| showing.text());
            // The board may run another model now.
            self.board = None;
            prompt = self.prompt();
        }
        let holds = now_ms < self.held_until_ms;
        if holds != engine.bridge().is_shown() {
            engine.show_key(holds, now_ms);
        }
        engine.set_prompt(prompt);
    }

    /// Whenever the board reports another model, the possible actions are determined again.
    fn look<D: Door>(&mut self, engine: &Engine<'static, D>) {
        let link = engine.bridge().link(Hand::Right);
        let (Some(identity), Some(model)) = (link.identity(), link.model()) else { return };
        let board = (identity.boot_id, model.model_id);
        if self.board == Some(board) || self.showing.is_some() {
            return;
        }
        let job = Job::Look { model_id: model.model_id, labels: model.labels.clone() };
        match self.jobs.try_send(job) {
            Ok(()) => (self.board, self.unanswered) = (Some(board), self.unanswered + 1),
            // The thread has not read the job yet.
            Err(TrySendError::Full(_)) => {}
            Err(TrySendError::Disconnected(_)) => {
                self.offer = Offer::Cannot(THREAD_ENDED.to_owned());
            }
        }
    }

    fn answered(&mut self, now_ms: u64) {
        while let Ok(answer) = self.answers.try_recv() {
            self.take(answer, now_ms);
        }
    }

    fn take(&mut self, answer: Answer, now_ms: u64) {
        self.unanswered = self.unanswered.saturating_sub(1);
        match (answer, &mut self.showing) {
            (Answer::Offer(offer), _) => self.offer = offer,
            (Answer::Learnt(blob), Some(showing)) => showing.learnt(blob, now_ms),
            // The action was cancelled in the meantime.
            // The model is stored, and is offered when the board is checked again.
            (Answer::Learnt(_), None) => self.board = None,
        }
    }

    fn begin_or_cancel<D: Door>(&mut self, engine: &Engine<'static, D>, now_ms: u64) {
        if let Some(showing) = &mut self.showing {
            showing.cancel("as you wished", now_ms);
            return;
        }
        let Some(identity) = engine.bridge().link(Hand::Right).identity() else { return };
        if !engine.is_set_up(Hand::Right) {
            // The commands that a board gets at its start would end its record mode.
            self.pressed = true;
            return;
        }
        let request = FOREIGN_REQUESTS.wrapping_add(self.showings.wrapping_mul(REQUESTS) & 0x3fff);
        let (boot_id, sample_hz) = (identity.boot_id, identity.sample_hz);
        self.showing = match &self.offer {
            Offer::Show { labels, .. } => {
                Some(Showing::new(labels.clone(), sample_hz, boot_id, request, now_ms))
            }
            // The model was parsed when it was read.
            Offer::Send { blob, .. } => {
                Upload::new(blob, request).ok().map(|upload| Showing::sending(upload, boot_id, now_ms))
            }
            Offer::Looking | Offer::Cannot(_) => None,
        };
        self.showings = self.showings.wrapping_add(1);
        if self.showing.is_some() {
            self.result = None;
        }
    }

    /// Returns the text and button that the wearer sees now.
    fn prompt(&self) -> Option<Prompt> {
        if let Some(showing) = &self.showing {
            return Some(Prompt { text: showing.text(), button: showing.button() });
        }
        let (text, button) = match &self.offer {
            Offer::Looking => return None,
            Offer::Show { text, .. } => (text, Some("show three of each")),
            Offer::Send { text, .. } => (text, Some("send the kept model")),
            Offer::Cannot(text) => (text, None),
        };
        let result = self.result.as_ref().map(|result| format!("{result}. ")).unwrap_or_default();
        Some(Prompt { text: format!("{result}{text}"), button })
    }

    /// Every change is an event, except for the count of bytes.
    fn tell<D: Door>(&mut self, text: &str, engine: &mut Engine<'static, D>, now_ms: u64) {
        if text == self.told {
            return;
        }
        let plain = |text: &str| text.split(|c: char| c.is_ascii_digit()).next().map(str::to_owned);
        let is_progress = text.contains(" bytes;") && plain(text) == plain(&self.told);
        if !is_progress {
            engine.tell_wearer(text.to_owned(), now_ms);
        }
        self.told = text.to_owned();
    }
}

/// Returns the text that asks the wearer to show each of these gestures. It also says what follows.
fn offer_to_show(name: Option<&str>, labels: &[String], seconds: usize) -> String {
    let who = match name {
        Some(name) => format!("{name} has shown nothing yet"),
        None => "who wears the right hand is not known (--wearer NAME)".to_owned(),
    };
    format!(
        "{who}: show each of {} {TIMES} times, about {seconds} s in all, and the model learns your hand; what you show \
         does not move the robot",
        labels.join(", ")
    )
}
