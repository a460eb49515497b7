//! Test support: settings, plant processes, and a minimal daemon that answers measurements.
#![allow(dead_code)] // each test file uses its own part

use std::process::{Child, Command as Process, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::{
    Client, Command, Measurement, Node, PlantKind, PlantRequest, PlantResponse, Reader, TempDomain, Writer,
};
use upswing_model::{ActuatedVector, JointVector, Model, Sizes, State, Workspace};
use upswing_plant::Plant;

static SETTINGS: LazyLock<Config> = LazyLock::new(|| Config::embedded().unwrap());

pub fn settings() -> Config {
    SETTINGS.clone()
}

/// Numbers of joints of the robot.
pub fn sizes() -> Sizes {
    SETTINGS.model.sizes()
}

/// The settings without friction and stops.
pub fn frictionless() -> Config {
    let mut config = settings();
    let friction = &mut config.plant.friction;
    friction.viscous.unactuated_mut().fill(0.0);
    friction.coulomb.unactuated_mut().fill(0.0);
    friction.compensation = 1.0;
    config.plant.stops.stiffness.fill(0.0);
    config
}

/// Velocities of all joints at rest, rad/s.
pub fn at_rest() -> JointVector {
    JointVector::zeros(sizes())
}

/// Arm pose [0, 0, 0, -90, 0, 0, 0] deg, in which the pendulum hangs at q8 = q9 = 0; rad.
pub fn level_pose() -> JointVector {
    let mut q = at_rest();
    q[3] = -90_f64.to_radians();
    q
}

/// Command with released brakes and torques `tau`, N m.
pub fn torque(tau: &ActuatedVector) -> Command {
    Command::new(tau)
}

/// Command with released brakes and the same torque on all actuated joints, N m.
pub fn equal_torques(tau: f64) -> Command {
    torque(&ActuatedVector::repeat(sizes(), tau))
}

/// Command that closes the brakes.
pub fn brake() -> Command {
    Command { brake: 1, ..equal_torques(0.0) }
}

/// Measured positions of all joints in the present cycle, rad.
pub fn measured_position(plant: &Plant) -> JointVector {
    plant.measure().vectors(plant.order()).unwrap().0
}

/// Measured torques in the present cycle, N m.
pub fn measured_torque(plant: &Plant) -> ActuatedVector {
    plant.measure().vectors(plant.order()).unwrap().1
}

/// Sum of kinetic and potential energy, J.
pub fn energy(model: &Model, plant: &Plant) -> f64 {
    model.energy(&State::new(plant.position(), plant.velocity()), &mut Workspace::default())
}

/// Torque that holds the arm in its present position, N m.
pub fn holding_torque(model: &Model, plant: &Plant) -> ActuatedVector {
    model.torque(
        &State::new(plant.position(), plant.velocity()),
        &ActuatedVector::zeros(model.sizes()),
        &mut Workspace::default(),
    )
}

/// A plant process; killed when dropped.
pub struct PlantProcess(Child);

impl PlantProcess {
    pub fn start(domain: &TempDomain, options: &[&str]) -> Self {
        let child = Process::new(env!("CARGO_BIN_EXE_upswing-plant"))
            .args(["--domain", domain.name()])
            .args(options)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self(child)
    }

    /// Sends SIGTERM and returns the exit code.
    pub fn terminate(mut self) -> Option<i32> {
        let id = libc::pid_t::try_from(self.0.id()).unwrap();
        // SAFETY: a plain system call; the process is our child and not yet waited for.
        assert_eq!(unsafe { libc::kill(id, libc::SIGTERM) }, 0);
        wait_for("the end of the plant", || self.0.try_wait().unwrap()).code()
    }

    pub fn is_alive(&mut self) -> bool {
        self.0.try_wait().unwrap().is_none()
    }
}

impl Drop for PlantProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Connection to the plant process, for the roles of harness and daemon.
pub struct Peer {
    client: Client<PlantRequest>,
    node: Node,
}

impl Peer {
    pub fn join(domain: &TempDomain) -> Self {
        let node = domain.join("daemon").unwrap();
        Self { client: node.client::<PlantRequest>().unwrap(), node }
    }

    /// A reader of the measurements, which keeps their shared memory mapped.
    pub fn measurements(&self) -> Reader<Measurement> {
        let mut finder = self.node.finder::<Measurement>();
        wait_for("a plant", || finder.poll().unwrap())
    }

    pub fn commands(&self) -> Writer<Command> {
        self.node.writer::<Command>().unwrap()
    }

    pub fn ask(&self, request: PlantRequest) -> PlantResponse {
        wait_for("an answer of the plant", || self.client.call(&request, Duration::from_secs(5)).ok())
    }

    pub fn status(&self) -> PlantResponse {
        self.ask(PlantRequest::new(PlantKind::Status))
    }

    pub fn advance_to(&self, seq: u64) -> PlantResponse {
        self.ask(PlantRequest { seq, ..PlantRequest::new(PlantKind::AdvanceTo) })
    }
}

/// Minimal daemon that answers each measurement once, with released brakes and no torque.
pub struct Answerer {
    pub measurements: Reader<Measurement>,
    commands: Writer<Command>,
    seq: u64,
    answered: u64,
}

impl Answerer {
    pub fn join(peer: &Peer) -> Self {
        Self::new(peer.measurements(), peer.commands())
    }

    pub fn new(measurements: Reader<Measurement>, commands: Writer<Command>) -> Self {
        Self { measurements, commands, seq: 0, answered: 0 }
    }

    /// Answers the newest measurement if it is not answered yet, and returns it.
    pub fn answer(&mut self) -> Option<Measurement> {
        let measurement = self.measurements.read();
        if measurement.seq == self.answered {
            return None;
        }
        self.answered = measurement.seq;
        self.seq += 1;
        self.commands.write(Command {
            seq: self.seq,
            t_ns: measurement.t_ns,
            measurement_seq: measurement.seq,
            ..equal_torques(0.0)
        });
        Some(measurement)
    }

    /// Answers measurements until `done` returns true.
    pub fn answer_until(&mut self, what: &str, mut done: impl FnMut() -> bool) {
        let start = Instant::now();
        while !done() {
            for _ in 0..100 {
                self.answer();
                std::thread::yield_now();
            }
            assert_not_stuck(start, what);
        }
    }
}

/// Repeats `attempt` until it returns a value; panics when the test is clearly stuck.
pub fn wait_for<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = attempt() {
            return found;
        }
        assert_not_stuck(start, what);
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn assert_not_stuck(start: Instant, what: &str) {
    assert!(start.elapsed() < Duration::from_secs(120), "stuck while waiting for {what}");
}
