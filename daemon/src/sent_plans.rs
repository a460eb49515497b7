//! Tracks which plan the controller has loaded, from its answers.

use std::collections::VecDeque;

/// Plans sent to the controller, with the numbers of their requests.
#[derive(Debug, Default)]
pub(crate) struct SentPlans {
    /// Id of the last plan that the controller accepted; 0: none.
    taken: u64,
    /// Numbers of the requests without an answer yet, and the ids of their plans.
    waiting: VecDeque<(u64, u64)>,
}

impl SentPlans {
    /// Notes that a plan was sent to the controller.
    pub(crate) fn sent(&mut self, request: u64, plan: u64) {
        self.waiting.push_back((request, plan));
    }

    /// Notes the answer to a request; returns the id of its plan, `None` if the request is not about a plan.
    pub(crate) fn answered(&mut self, request: u64, taken: bool) -> Option<u64> {
        // Answers come in the order of the requests.
        let (_, plan) = *self.waiting.front().filter(|(waiting, _)| *waiting == request)?;
        self.waiting.pop_front();
        if taken {
            self.taken = plan;
        }
        Some(plan)
    }

    /// Id of the last plan that was sent and not refused; 0: none.
    pub(crate) fn newest(&self) -> u64 {
        self.waiting.back().map_or(self.taken, |(_, plan)| *plan)
    }
}

#[cfg(test)]
mod tests {
    use super::SentPlans;

    #[test]
    fn a_refusal_leaves_the_plan_before() {
        let mut sent_plans = SentPlans::default();
        sent_plans.sent(1, 10);
        assert_eq!((sent_plans.answered(1, true), sent_plans.newest()), (Some(10), 10));
        // Two more plans wait for answers at the same time, and both are refused.
        sent_plans.sent(2, 20);
        sent_plans.sent(4, 30);
        assert_eq!(sent_plans.newest(), 30);
        assert_eq!((sent_plans.answered(2, false), sent_plans.newest()), (Some(20), 30));
        assert_eq!((sent_plans.answered(3, false), sent_plans.newest()), (None, 30));
        assert_eq!((sent_plans.answered(4, false), sent_plans.newest()), (Some(30), 10));
    }
}
