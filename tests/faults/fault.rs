//! Every fault by name.

use std::time::Duration;

use anyhow::Result;
use clap::ValueEnum;
use stereo_tests::clock;

use crate::table::Row;
use crate::{links, memory, network, process, system};

/// What fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Fault {
    Panic,
    Stuck,
    Killed,
    KilledOfTwo,
    Stopped,
    Frozen,
    DiskFull,
    ReadOnly,
    Descriptors,
    Memory,
    ClockForward,
    ClockBack,
    HalfOpen,
    SlowReaders,
    #[value(name = "loss-1")]
    Loss1,
    #[value(name = "loss-5")]
    Loss5,
    Jitter,
    Narrow,
    Flapping,
}

impl Fault {
    /// All of them, in the table's order.
    pub(crate) fn all() -> Vec<Self> {
        Self::value_variants().to_vec()
    }

    /// As the command line has it.
    pub(crate) fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Whether it can be provoked here; `inside`: in namespaces of this program's own.
    pub(crate) fn is_possible(self, inside: bool) -> Result<(), String> {
        match self {
            Self::DiskFull | Self::ReadOnly | Self::HalfOpen | Self::Loss1 | Self::Loss5 | Self::Narrow
                if !inside =>
            {
                Err(
                    "no namespaces can be made here: this takes root, or user namespaces, and iproute2"
                        .to_owned(),
                )
            }
            Self::Loss1 | Self::Loss5 => links::can_lose(),
            Self::ClockForward | Self::ClockBack => clock::is_possible(),
            _ => Ok(()),
        }
    }

    /// Lets it happen to a server of its own.
    pub(crate) async fn provoke(self) -> Result<Row> {
        match self {
            Self::Panic => process::panic().await,
            Self::Stuck => process::stuck().await,
            Self::Killed => process::killed().await,
            Self::KilledOfTwo => process::killed_of_two().await,
            Self::Stopped => process::stopped().await,
            Self::Frozen => process::frozen().await,
            Self::DiskFull => system::disk_full().await,
            Self::ReadOnly => system::read_only().await,
            Self::Descriptors => system::descriptors().await,
            Self::Memory => memory::limited().await,
            Self::ClockForward => system::clock("+1h", "the clock steps an hour forward").await,
            Self::ClockBack => system::clock("-1h", "the clock steps an hour back").await,
            Self::HalfOpen => network::half_open().await,
            Self::SlowReaders => network::slow_readers().await,
            Self::Loss1 => links::loss(0.01, "1 % of the packets are lost, each way").await,
            Self::Loss5 => links::loss(0.05, "5 % of the packets are lost, each way").await,
            Self::Jitter => links::jitter(Duration::from_millis(100)).await,
            Self::Narrow => links::narrow("10mbit", "a link of 10 Mbit/s").await,
            Self::Flapping => network::flapping().await,
        }
    }
}

/// Those that take nothing but this program; the others are provoked by `make faults`, and so is the router that comes and goes, whose clients
/// lose a request now and then.
#[cfg(test)]
mod tests {
    use tokio::sync::Mutex;

    use super::Fault;

    /// One after the other: each loads the machine.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::const_new(());

    async fn nothing_is_lost(fault: Fault) {
        if let Err(why) = fault.is_possible(false) {
            println!("skipped: {why}");
            return;
        }
        let _turn = ONE_AT_A_TIME.lock().await;
        let row = fault.provoke().await.expect("a fault that can be provoked");
        assert_eq!(row.broken_promise(), None);
    }

    macro_rules! survived {
        ($($name:ident: $fault:ident),+ $(,)?) => {
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $name() {
                nothing_is_lost(Fault::$fault).await;
            })+
        };
    }

    survived! {
        a_panic_of_a_worker_fails_one_frame_alone: Panic,
        a_worker_that_is_stuck_is_replaced: Stuck,
        a_server_killed_under_load_serves_again_once_it_is_started: Killed,
        a_server_killed_beside_another_costs_a_retrying_client_nothing: KilledOfTwo,
        what_was_admitted_is_answered_though_the_server_is_told_to_stop_under_twice_its_load: Stopped,
        a_server_that_was_frozen_answers_everything_afterwards: Frozen,
        a_server_without_descriptors_serves_who_is_connected_and_others_later: Descriptors,
        more_pairs_than_memory_are_refused_and_the_limit_is_kept: Memory,
        a_clock_that_steps_forward_ends_nothing: ClockForward,
        a_clock_that_steps_back_ends_nothing: ClockBack,
        clients_that_do_not_read_are_not_noticed_by_others: SlowReaders,
        jitter_delays_and_loses_nothing: Jitter,
    }
}
