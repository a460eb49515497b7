//! Tracks which plan the controller has loaded, from its answers.

use std::collections::VecDeque;

/// Plans sent to the controller, with the numbers of their requests.
#[derive(Debug, Default)]
pub(crate) struct SentPlans {
    /// Id of the last plan for a start that the controller accepted; 0: none.
    taken: u64,
    /// Plans without an answer yet.
    waiting: VecDeque<SentPlan>,
}

/// A plan that was sent to the controller.
#[derive(Clone, Copy, Debug)]
struct SentPlan {
    /// Number of the request.
    request: u64,
    id: u64,
    /// Whether a request starts the plan; otherwise it replaces a running one.
    for_start: bool,
}

impl SentPlans {
    /// Notes that a plan was sent to the controller.
    pub(crate) fn sent(&mut self, request: u64, id: u64, for_start: bool) {
        self.waiting.push_back(SentPlan { request, id, for_start });
    }

    /// Notes the answer to a request; returns the id of its plan, `None` if the request is not about a plan.
    pub(crate) fn answered(&mut self, request: u64, taken: bool) -> Option<u64> {
        // Answers come in the order of the requests.
        let SentPlan { id, for_start, .. } = *self.waiting.front().filter(|sent| sent.request == request)?;
        self.waiting.pop_front();
        if taken && for_start {
            self.taken = id;
        }
        Some(id)
    }

    /// Id of the last plan for a start that was sent and not refused; 0: none.
    pub(crate) fn newest(&self) -> u64 {
        self.waiting.iter().rev().find(|sent| sent.for_start).map_or(self.taken, |sent| sent.id)
    }
}

#[cfg(test)]
mod tests {
    use super::SentPlans;

    #[test]
    fn a_refusal_leaves_the_plan_before() {
        let mut sent_plans = SentPlans::default();
        sent_plans.sent(1, 10, true);
        assert_eq!((sent_plans.answered(1, true), sent_plans.newest()), (Some(10), 10));
        // Two more plans wait for answers at the same time, and both are refused.
        sent_plans.sent(2, 20, true);
        sent_plans.sent(4, 30, true);
        assert_eq!(sent_plans.newest(), 30);
        assert_eq!((sent_plans.answered(2, false), sent_plans.newest()), (Some(20), 30));
        assert_eq!((sent_plans.answered(3, false), sent_plans.newest()), (None, 30));
        assert_eq!((sent_plans.answered(4, false), sent_plans.newest()), (Some(30), 10));
    }

    #[test]
    fn a_plan_that_replaces_another_is_not_the_next_one_to_start() {
        let mut sent_plans = SentPlans::default();
        sent_plans.sent(1, 10, true);
        sent_plans.sent(2, 20, false);
        assert_eq!(sent_plans.newest(), 10);
        assert_eq!((sent_plans.answered(1, true), sent_plans.answered(2, true)), (Some(10), Some(20)));
        assert_eq!(sent_plans.newest(), 10);
    }
}
