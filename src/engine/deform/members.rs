//! The handles behind the columns of a table, for those who pose it themselves.

use super::{Handle, RestDeformation};

/// A position of a client's handle that a column belongs to. The column's position, at rest and
/// posed, is the sum of its members' positions, each times its share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColumnMember {
    /// The column of the table.
    pub column: usize,
    /// Index of the handle in the client's order.
    pub handle: usize,
    /// Index of the position in the handle: 0 of a point.
    pub place: usize,
    /// 1, except in a group of coincident points.
    pub share: f64,
}

impl RestDeformation {
    /// The members of all columns, in the order of the client's handles. A point has one, a segment
    /// one for each end.
    #[must_use]
    pub fn column_members(&self) -> Vec<ColumnMember> {
        let given = self.client_handles();
        let grouped = self.grouped.as_ref().map(|grouped| grouped.1.columns());
        let mut members = Vec::with_capacity(given.columns());
        let mut add = |handle, place, share| {
            let column = grouped
                .as_ref()
                .map_or(members.len(), |grouped| grouped[members.len()]);
            members.push(ColumnMember {
                column,
                handle,
                place,
                share,
            });
        };
        for (handle, (places, &weight)) in given.handles().iter().zip(given.weights()).enumerate() {
            match places {
                Handle::Point(_) => add(handle, 0, weight),
                Handle::Missing => {}
                Handle::Polyline(places) => (1..places.len())
                    .flat_map(|end| [end - 1, end])
                    .for_each(|place| add(handle, place, weight)),
            }
        }
        let mut totals = vec![0.0; self.handles().columns()];
        members
            .iter()
            .for_each(|member| totals[member.column] += member.share);
        members
            .iter_mut()
            .for_each(|member| member.share /= totals[member.column]);
        members
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{Falloff, Handles, Method};
    use crate::geometry::Point;

    #[test]
    fn a_group_is_one_column_and_a_segment_two() {
        let point = |x: f64| Handle::Point(Point::new(x, 5.0));
        let line = Handle::Polyline(vec![
            Point::new(0.0, 0.0),
            Point::new(9.0, 0.0),
            Point::new(9.0, 4.0),
        ]);
        let handles = Handles::new(
            vec![point(2.0), line, point(7.0), point(2.0)],
            Some(vec![1.0, 2.0, 1.0, 3.0]),
        )
        .unwrap();
        let field = RestDeformation::new(
            handles,
            Method::Rigid,
            Falloff::new(2.0, true).unwrap(),
            1.0,
        )
        .unwrap();
        let members: Vec<_> = field
            .column_members()
            .iter()
            .map(|m| (m.column, m.handle, m.place, m.share))
            .collect();
        let segments = [
            (1, 1, 0, 1.0),
            (2, 1, 1, 1.0),
            (3, 1, 1, 1.0),
            (4, 1, 2, 1.0),
        ];
        assert_eq!(
            members,
            [
                &[(0, 0, 0, 0.25)][..],
                &segments,
                &[(5, 2, 0, 1.0), (0, 3, 0, 0.75)]
            ]
            .concat()
        );
    }
}
