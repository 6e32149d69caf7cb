//! A board whose image has Nordic's controller inside.

use super::super::controller::Controller;
use super::{ANSWERED, Board};

impl Board {
    /// Answers Nordic's controller, which the image has inside, from outside.
    pub fn answer_controller(&mut self, controller: Controller) {
        let world = self.uc.get_data_mut();
        for address in controller.addresses() {
            world.blocks[address as usize / 2] = ANSWERED;
        }
        world.soc.controller = Some(Box::new(controller));
        world.soc.settle();
    }

    /// Nordic's controller inside the image.
    ///
    /// # Panics
    /// If it is not [answered](Self::answer_controller).
    pub fn controller(&mut self) -> &mut Controller {
        self.soc().controller.as_mut().expect("the image has a controller")
    }

    /// Whether Nordic's controller inside the image has a connection.
    pub fn is_connected(&self) -> bool {
        self.uc.get_data().soc.controller.as_ref().is_some_and(|controller| controller.is_connected())
    }

    /// Tells bumble's laptop to do something; the number under which its outcome will stand in the air's log.
    ///
    /// # Panics
    /// As [`Self::controller`].
    pub fn order(&mut self, order: serde_json::Value) -> u64 {
        let soc = self.soc();
        let mut controller = soc.controller.take().expect("the image has a controller");
        let number = controller.order(order, soc);
        soc.controller = Some(controller);
        soc.settle();
        number
    }
}
