//! A board whose image contains Nordic's controller.

use super::super::controller::Controller;
use super::{ANSWERED, Board};

impl Board {
    /// Lets the emulator execute the functions of Nordic's controller, which is linked into the image.
    pub fn answer_controller(&mut self, controller: Controller) {
        let world = self.uc.get_data_mut();
        for address in controller.addresses() {
            world.blocks[address as usize / 2] = ANSWERED;
        }
        world.soc.number = controller.number();
        world.soc.controller = Some(Box::new(controller));
        world.soc.settle();
    }

    /// Returns the model of Nordic's controller.
    ///
    /// # Panics
    /// Panics if the emulator does not [execute the controller](Self::answer_controller).
    pub fn controller(&mut self) -> &mut Controller {
        self.soc().controller.as_mut().expect("the image has a controller")
    }

    /// Returns whether Nordic's controller in the image has a connection.
    pub fn is_connected(&self) -> bool {
        self.uc.get_data().soc.controller.as_ref().is_some_and(|controller| controller.is_connected())
    }

    /// Sends a command to bumble's laptop. Returns the number under which the air's log will contain the result.
    ///
    /// # Panics
    /// Panics for the same reason as [`Self::controller`].
    pub fn order(&mut self, order: serde_json::Value) -> u64 {
        let soc = self.soc();
        let mut controller = soc.controller.take().expect("the image has a controller");
        let number = controller.order(order, soc);
        soc.controller = Some(controller);
        soc.settle();
        number
    }
}
