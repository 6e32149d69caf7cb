//! The emulator's callbacks: blocks, probes, accesses, and the end of a run.

use super::*;

fn decode(soc_flash: &[u8], address: u32, size: u32) -> u64 {
    let mut count = 0;
    let mut at = address as usize;
    let end = at + size as usize;
    while at < end {
        let half = soc_flash.get(at..at + 2).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
        at += if half >> 11 >= 0b11101 { 4 } else { 2 };
        count += 1;
    }
    count
}

impl Board {
    pub(super) fn hook(uc: &mut Unicorn<'static, World>, flash: &[u8]) {
        uc.add_block_hook(1, 0, |uc, address, size| {
            let address = address as u32;
            let world = uc.get_data_mut();
            let soc = &mut world.soc;
            let ready = soc.now >= soc.due || soc.nvic.reset_wanted || soc.nvmc.busy_until > soc.now;
            if ready || soc.nvic.any_ready() {
                let masked = !ready && {
                    let masked = uc.reg_read(RegisterARM::PRIMASK).unwrap_or(0) & 1 != 0;
                    let world = uc.get_data_mut();
                    masked || world.soc.nvic.next(0).is_none()
                };
                if !masked {
                    uc.get_data_mut().stop = Some(Stop::Attention { at: address });
                    let _ = uc.emu_stop();
                    return;
                }
            }
            let world = uc.get_data_mut();
            let soc = &mut world.soc;
            let count = match world.blocks.get_mut(address as usize / 2) {
                Some(&mut ANSWERED) if world.passes.take() == Some(address) => {
                    decode(&soc.flash, address, size)
                }
                Some(&mut ANSWERED) => {
                    world.stop = Some(Stop::Function(address));
                    let _ = uc.emu_stop();
                    return;
                }
                Some(&mut known @ 1..) => u64::from(known),
                Some(unknown) => {
                    let count = decode(&soc.flash, address, size);
                    *unknown = count as u16;
                    count
                }
                None => decode(&soc.flash, address, size),
            };
            if !world.open.is_empty() && soc.nvic.active().is_empty() {
                while let Some(&open) = world.open.last() {
                    if open.back != address {
                        break;
                    }
                    world.open.pop();
                    let instructions = world.thread_instructions - open.instructions_before;
                    let stack_bytes = if world.painting.contains(&open.probe) {
                        let below = world.soc.ram.get(open.stack_pointer - PAINTED as u32, PAINTED);
                        let clean = below.map_or(0, |b| b.iter().take_while(|&&byte| byte == PAINT).count());
                        (PAINTED - clean) as u32
                    } else {
                        0
                    };
                    world.calls[open.probe].push(Call { at: open.at, instructions, stack_bytes });
                }
            }
            if let Some(&(_, probe)) = world.probes.iter().rev().find(|(at, _)| *at == address) {
                let back = uc.reg_read(RegisterARM::LR).unwrap_or(0) as u32 & !1;
                let stack_pointer = uc.reg_read(RegisterARM::SP).unwrap_or(0) as u32;
                let world = uc.get_data_mut();
                if world.painting.contains(&probe) {
                    // The memory below the stack pointer is not in use.
                    world.soc.ram.put(stack_pointer - PAINTED as u32, &[PAINT; PAINTED]);
                }
                let (at, instructions_before) = (world.soc.now, world.thread_instructions);
                world.open.push(Open { back, probe, at, instructions_before, stack_pointer });
            }
            let world = uc.get_data_mut();
            if let Some(&(_, tap, len)) = world.taps.iter().rev().find(|(at, ..)| *at == address) {
                let registers = [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2, RegisterARM::R3]
                    .map(|r| uc.reg_read(r).unwrap_or(0) as u32);
                let bytes = uc.mem_read_as_vec(registers[0].into(), len).unwrap_or_default();
                let world = uc.get_data_mut();
                world.tapped[tap].push(Tapped { at: world.soc.now, registers, bytes });
            }
            let world = uc.get_data_mut();
            world.instructions += count;
            if world.soc.nvic.active().is_empty() {
                world.thread_instructions += count;
            }
            world.half += count * CYCLES_PER_TWO;
            let cycles = world.half / 2;
            world.half %= 2;
            world.executed += cycles;
            world.soc.now += cycles;
            world.soc.awake += cycles;
        })
        .expect("a hook");
        uc.add_intr_hook(|uc, number| {
            let pc = uc.reg_read(RegisterARM::PC).unwrap_or(0) as u32;
            uc.get_data_mut().stop = Some(match number {
                8 => Stop::ExceptionReturn,
                2 => Stop::Supervisor,
                _ => Stop::Fault(pc),
            });
            let _ = uc.emu_stop();
        })
        .expect("a hook");
        uc.add_mem_hook(HookType::MEM_INVALID, 1, 0, |uc, kind, address, size, value| {
            let world = uc.get_data_mut();
            world.bad_access = Some(format!("{kind:?} at {address:#x}, {size} bytes, {value:#x}"));
            false
        })
        .expect("a hook");
        // Finds WFE, WFI, SEV and all instructions that mask interrupts.
        for (at, half) in flash.chunks_exact(2).enumerate() {
            let next = flash.get(at * 2 + 2..at * 2 + 4).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
            let at = (at * 2) as u64;
            match u16::from_le_bytes([half[0], half[1]]) {
                0xBF20 | 0xBF30 => {
                    let for_event = half[0] == 0x20;
                    uc.add_code_hook(at, at, move |uc, address, _| {
                        uc.get_data_mut().stop = Some(Stop::Wait { at: address as u32, for_event });
                        let _ = uc.emu_stop();
                    })
                    .expect("a hook");
                }
                0xBF40 => {
                    uc.add_code_hook(at, at, |uc, _, _| uc.get_data_mut().event = true).expect("a hook");
                }
                // These are CPSID, CPSIE, and MSR PRIMASK from a register.
                0xB672 | 0xB662 => {
                    let masks = half[0] == 0x72;
                    uc.add_code_hook(at, at, move |uc, _, _| uc.get_data_mut().mask(masks)).expect("a hook");
                }
                first @ 0xF380..=0xF38F if next == 0x8810 => {
                    let register = RegisterARM::R0 as i32 + i32::from(first & 0xF);
                    uc.add_code_hook(at, at, move |uc, _, _| {
                        let masks = uc.reg_read(register).unwrap_or(0) & 1 != 0;
                        uc.get_data_mut().mask(masks);
                    })
                    .expect("a hook");
                }
                _ => {}
            }
        }
    }
}
