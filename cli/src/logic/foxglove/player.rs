//! The clock of a record that is played: begin, pause, speed and jumps, on virtual time.

use super::protocol::{Control, Playback, PlaybackStatus};
use comms::logic::time::Time;
use std::time::Duration;

/// How often the clock moves while it runs.
const TICK: Duration = Duration::from_millis(20);
/// The most that the clock moves at once, at its normal speed. After a longer pause of this program, the playback continues where it was.
const STEP_MAX: Duration = Duration::from_millis(500);
/// The speeds that can be chosen.
const SPEED_MIN: f64 = 0.01;
const SPEED_MAX: f64 = 100.0;

/// The clock of a record.
#[derive(Clone, Debug)]
pub(super) struct Player {
    begin: Duration,
    end: Duration,
    position: Duration,
    speed: f64,
    status: PlaybackStatus,
    /// When the clock moved last.
    moved: Time,
}

impl Player {
    /// Returns a clock that is stopped at its begin. The times are since 1970.
    pub(super) fn new(begin: Duration, end: Duration) -> Self {
        Self { begin, end, position: begin, speed: 1.0, status: PlaybackStatus::Paused, moved: Time::ZERO }
    }

    /// Returns the time of the record, since 1970.
    pub(super) fn position(&self) -> Duration {
        self.position
    }

    /// Returns when the clock has to move next. Never, while it is stopped.
    pub(super) fn deadline(&self) -> Option<Time> {
        (self.status == PlaybackStatus::Playing).then_some(self.moved + TICK)
    }

    /// Moves the clock. Returns whether it has reached its end.
    pub(super) fn advance(&mut self, now: Time) -> bool {
        if self.status != PlaybackStatus::Playing {
            return false;
        }
        let passed = now.since(self.moved).min(STEP_MAX);
        self.moved = now;
        self.position = (self.position + passed.mul_f64(self.speed)).min(self.end);
        let is_over = self.position == self.end;
        if is_over {
            self.status = PlaybackStatus::Ended;
        }
        is_over
    }

    /// Carries out the request of a client. Returns whether the clock has jumped.
    pub(super) fn control(&mut self, now: Time, control: &Control) -> bool {
        self.advance(now);
        if let Some(speed) = control.speed.filter(|speed| speed.is_finite() && *speed > 0.0) {
            self.speed = speed.clamp(SPEED_MIN, SPEED_MAX);
        }
        let mut target = control.seek.map(|seek| seek.clamp(self.begin, self.end));
        // Played again from its end, it begins again.
        if control.plays == Some(true) && target.unwrap_or(self.position) == self.end {
            target = Some(self.begin);
        }
        if let Some(target) = target {
            self.position = target;
        }
        match control.plays {
            Some(true) => (self.status, self.moved) = (PlaybackStatus::Playing, now),
            Some(false) => self.status = PlaybackStatus::Paused,
            // A jump away from the end does not begin to play.
            None if self.status == PlaybackStatus::Ended && self.position < self.end => {
                self.status = PlaybackStatus::Paused;
            }
            None => {}
        }
        target.is_some()
    }

    /// Returns a moment that is this long behind the begin.
    pub(super) fn at(&self, seconds: f64) -> Duration {
        let offset = Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::MAX);
        self.begin.saturating_add(offset)
    }

    /// Returns its state for clients.
    pub(super) fn state(&self, has_jumped: bool, request: &str) -> Playback {
        let Self { position, speed, status, .. } = *self;
        Playback { status, position, speed, has_jumped, request: request.to_owned() }
    }

    /// Returns the position and the length, in seconds.
    pub(super) fn seconds(&self) -> (f64, f64) {
        let since_begin = |at: Duration| at.saturating_sub(self.begin).as_secs_f64();
        (since_begin(self.position), since_begin(self.end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    const BEGIN: Duration = Duration::from_secs(1_800_000_000);

    fn at(millis: u64) -> Time {
        Time::ZERO + Duration::from_millis(millis)
    }

    fn player() -> Player {
        Player::new(BEGIN, BEGIN + Duration::from_secs(10))
    }

    fn seconds(player: &Player) -> f64 {
        player.seconds().0
    }

    fn plays(plays: bool) -> Control {
        Control { plays: Some(plays), ..Control::default() }
    }

    #[test]
    fn a_record_is_played_paused_and_played_again() {
        let mut player = player();
        assert_eq!((player.deadline(), player.advance(at(50))), (None, false));
        assert!(!player.control(at(1000), &plays(true)));
        assert_eq!(player.deadline(), Some(at(1020)));
        player.advance(at(1400));
        player.control(at(1500), &Control { speed: Some(2.0), ..Control::default() });
        player.advance(at(2000));
        assert!((seconds(&player) - 1.5).abs() < 1e-9, "{player:?}");
        player.control(at(2100), &plays(false));
        player.advance(at(9000));
        assert!((seconds(&player) - 1.7).abs() < 1e-9, "{player:?}");
        // After a long pause of this program, it continues where it was.
        player.control(at(10_000), &plays(true));
        player.advance(at(60_000));
        assert!((seconds(&player) - 2.7).abs() < 1e-9, "{player:?}");
    }

    #[test]
    fn the_end_is_told_once_and_the_record_begins_again() {
        let mut player = player();
        let seek = Control { seek: Some(BEGIN + Duration::from_millis(9900)), ..plays(true) };
        assert!(player.control(at(0), &seek));
        assert_eq!((player.advance(at(99)), player.advance(at(200)), player.advance(at(300))), (false, true, false));
        assert_eq!((player.state(false, "").status, player.deadline()), (PlaybackStatus::Ended, None));
        assert!(player.control(at(400), &plays(true)) && seconds(&player).abs() < 1e-9);
        assert!(player.control(at(400), &Control { seek: Some(Duration::ZERO), ..Control::default() }));
        assert_eq!(player.position(), BEGIN, "a time before the record is its begin");
    }

    /// The clock stays within the record for all orders, and moves backwards only in a jump.
    #[test]
    fn strange_orders_leave_the_clock_within_the_record() {
        for seed in 0..100 {
            let (mut random, mut player, mut now) = (Random::new(seed), player(), 0);
            for _ in 0..50 {
                now += random.below(2000);
                let before = player.position();
                let speeds = [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9, 0.5, 1e9];
                let speed = usize::try_from(random.below(14)).ok().and_then(|one| speeds.get(one)).copied();
                let seek = (random.below(3) == 0).then(|| {
                    BEGIN.saturating_sub(Duration::from_secs(5)) + Duration::from_millis(random.below(20_000))
                });
                let plays = [None, Some(true), Some(false)][usize::try_from(random.below(3)).unwrap()];
                let has_jumped = player.control(at(now), &Control { plays, speed, seek, ..Control::default() });
                now += random.below(500);
                player.advance(at(now));
                assert!(
                    player.position() >= BEGIN && player.position() <= BEGIN + Duration::from_secs(10),
                    "seed {seed}"
                );
                assert!(has_jumped || player.position() >= before, "seed {seed}");
            }
        }
    }
}
